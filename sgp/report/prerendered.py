"""Pictures under a few lights, for browsers without WebGL2 or scripts, and for paper."""

from __future__ import annotations

import base64
from typing import Final

import cv2
import numpy as np

from rig.arrays import AnyArray, Float32, Floating
from sgp.report.html import Html, joined, tag
from sgp.report.planes import VECTOR_STEPS, Plane

_SIDE_PX: Final = 360
_QUALITY: Final = 82
# Azimuth and elevation in degrees, and what the picture is called.
_LIGHTS: Final = (
    (135, 45, "from the upper left"),
    (45, 45, "from the upper right"),
    (225, 45, "from the lower left"),
    (315, 45, "from the lower right"),
    (180, 12, "raking, from the left"),
    (90, 12, "raking, from above"),
    (0, 12, "raking, from the right"),
    (0, 90, "from the camera"),
)


def prerendered(planes: dict[str, Plane], name: str, *, titled: bool = False) -> Html:
    """Return pictures of the normals, and of the albedo if there is one, under eight lights.

    With ``titled``, the name of the result is above them.
    """
    plane = planes.get("normals")
    if plane is None:
        return Html("")
    normals = reduced(_vectors(plane), _SIDE_PX)
    height, width, _ = normals.shape
    albedo = planes.get("albedo")
    factor = np.ones((1, 1, 1), np.float32)
    if albedo is not None:
        samples = reduced(albedo.samples.astype(np.float32), _SIDE_PX) / 255
        samples = samples.reshape(height, width, -1)
        factor = np.where(samples > 0.04045, ((samples + 0.055) / 1.055) ** 2.4, samples / 12.92)
    figures = []
    for azimuth, elevation, title in _LIGHTS:
        a, e = np.radians([azimuth, elevation])
        light = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], np.float32)
        source = jpeg(np.clip(normals @ light, 0, 1)[..., None] * factor, _QUALITY)
        picture = tag("img", src=source, alt=f"{name}, lit {title}", width=width, height=height)
        figures.append(tag("figure", picture, tag("figcaption", f"Light {title}")))
    heading = [tag("h3", name)] if titled else []
    return joined(heading, tag("div", figures, class_="prerendered"))


def _vectors(plane: Plane) -> Float32:
    """Return the unit vectors of a plane, 0 where it has no value."""
    e = (plane.samples.astype(np.float32) - 1) * np.float32(2 / VECTOR_STEPS) - 1
    z = 1 - np.abs(e).sum(axis=2)
    folded = (1 - np.abs(e[..., ::-1])) * np.where(e < 0, -1, 1)
    vectors = np.dstack([np.where(z[..., None] < 0, folded, e), z]).astype(np.float32)
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    vectors[plane.samples[..., 0] == 0] = 0
    return vectors


def reduced(values: AnyArray, side_px: int) -> Float32:
    """Return an image whose longer side has at most ``side_px`` pixels, averaged."""
    rows, columns = values.shape[:2]
    share = min(1.0, side_px / max(rows, columns))
    size = max(1, round(columns * share)), max(1, round(rows * share))
    small = cv2.resize(np.ascontiguousarray(values), size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)


def jpeg(light: Float32, quality: int) -> str:
    """Return linear light from 0 to 1, gray or RGB, as the address of an sRGB picture in JPEG."""
    return coded_jpeg(
        np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light), quality
    )


def coded_jpeg(coded: Floating, quality: int) -> str:
    """Return sRGB samples from 0 to 1, gray or RGB, as the address of a picture in JPEG."""
    samples = np.rint(255 * np.clip(coded, 0, 1)).astype(np.uint8)
    if samples.ndim == 3:
        samples = np.ascontiguousarray(samples[..., ::-1])
    encoded = cv2.imencode(".jpg", samples, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(encoded.tobytes()).decode()}"
