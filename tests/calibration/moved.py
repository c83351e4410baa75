"""Two recordings of the same lights, with two chrome spheres that were moved between them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from acquisition import write_camera, write_png
from simulator import Rendering, render, scene_named

RADII_MM = (20.0, 16.0)
# The recordings show the balls in opposite corners.
PLACES = (((-92, 58), (84, -66)), ((-88, -62), (86, 64)))


@cache
def rendered(recording: int, leds: int = 6) -> Rendering:
    scene = scene_named("spheres", width=320, height=256, leds=leds)
    # Four spheres may touch no others: a moved ball is the same ball elsewhere.
    balls = [
        replace(scene.spheres[0], centre_mm=(float(x), float(y), radius), radius_mm=radius)
        for (x, y), radius in zip(PLACES[recording], RADII_MM, strict=True)
    ]
    return render(replace(scene, spheres=tuple(balls)))


def planes(recording: int) -> np.ndarray:
    """Return linear images in which highlights are not saturated, as merged brackets are."""
    values = rendered(recording).planes
    return (values / np.percentile(values, 99)).astype(np.float32)


def masks(recording: int) -> list[np.ndarray]:
    return list(rendered(recording).truth.sphere_masks)


def write_folder(folder: Path, recording: int) -> Path:
    """Write 16-bit images with white at the brightest highlight, and the camera next to them."""
    folder.mkdir()
    values = rendered(recording).planes
    for led, image in enumerate(values):
        png = np.rint(65535 * image / values.max()).astype(np.uint16)
        write_png(folder / f"L{led:02d}.png", png)
    write_camera(folder.parent / "camera.json", rendered(recording).truth.camera)
    return folder
