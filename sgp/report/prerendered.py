"""Pictures under a few lights, for browsers without WebGL2 or scripts, and for paper."""

from __future__ import annotations

import base64
from typing import Final

import cv2
import numpy as np

from rig.arrays import Float32
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
    share = min(1.0, _SIDE_PX / max(plane.samples.shape[:2]))
    size = tuple(max(1, round(side * share)) for side in plane.samples.shape[1::-1])
    normals = _reduced(_vectors(plane), size)
    albedo = planes.get("albedo")
    factor = np.ones((1, 1, 1), np.float32)
    if albedo is not None:
        samples = _reduced(albedo.samples.astype(np.float32), size) / 255
        samples = samples.reshape(*samples.shape[:2], -1)
        factor = np.where(samples > 0.04045, ((samples + 0.055) / 1.055) ** 2.4, samples / 12.92)
    figures = []
    for azimuth, elevation, title in _LIGHTS:
        a, e = np.radians([azimuth, elevation])
        light = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], np.float32)
        lit = np.clip(normals @ light, 0, 1)[..., None] * factor
        coded = np.where(lit > 0.0031308, 1.055 * lit ** (1 / 2.4) - 0.055, 12.92 * lit)
        picture = np.rint(255 * np.clip(coded, 0, 1)).astype(np.uint8)[..., ::-1]
        encoded = cv2.imencode(
            ".jpg", np.ascontiguousarray(picture), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        )[1]
        source = f"data:image/jpeg;base64,{base64.b64encode(encoded.tobytes()).decode()}"
        figures.append(
            tag(
                "figure",
                tag("img", src=source, alt=f"{name}, lit {title}", width=size[0], height=size[1]),
                tag("figcaption", f"Light {title}"),
            )
        )
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


def _reduced(values: Float32, size: tuple[int, ...]) -> Float32:
    small = cv2.resize(values, (size[0], size[1]), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float32)
