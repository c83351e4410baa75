"""Recordings of a rendered card through a lens with vignetting and a sensor with PRNU."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from acquisition import CameraModel, Frame, NoiseModel, Source
from simulator import Lens, render, scene_named
from simulator.camera import fixed_pattern, sensor_image

SENSOR = NoiseModel(2.5, 2.5, 64.0, 12, dsnu_e=2.0, prnu=0.01)
EXPOSURE_US = 20_000.0
NOWHERE = Path("/nowhere")
# With 1, the law of the lens is cos^4; the corners are then at .67.
THIRTY_PERCENT = 0.93


def camera(width=320):
    """Return a camera with a field of 290 mm at 400 mm, whose corners are 25 degrees off axis."""
    height, focal = width * 4 // 5, width * 400 / 290
    K = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]
    return CameraModel(K, width, height, 400.0)


@dataclass(frozen=True)
class Card:
    """A rendered white card: electrons without noise, lights, and the vignetting."""

    planes: np.ndarray
    lights: object
    vignetting: np.ndarray
    camera: CameraModel
    cfa: str | None


@cache
def card(seed=1, leds=36, width=320, vignetting=THIRTY_PERCENT, cfa=None):
    model = camera(width)
    lens = Lens(model, vignetting=vignetting, sharp=False, cfa=cfa)
    rendering = render(replace(scene_named("white-plane", leds=leds, seed=seed), lens=lens))
    dimmed = lens.vignette(np.arange(model.width), np.arange(model.height)[:, None])
    return Card(rendering.planes, rendering.truth.lights, dimmed, model, cfa)


def response(size, sensor_seed, sensor=SENSOR):
    """Return the relative response of the pixels of a sensor."""
    return fixed_pattern(sensor, size, seed=sensor_seed).maps[0]


def recorded(
    made,
    seed,
    *,
    repeats=1,
    sensor_seed=5,
    level=0.8,
    texture=1.0,
    change=None,
    model=True,
    sensor=SENSOR,
    path=NOWHERE,
):
    """Record a card: 8 dark frames and repeats; ``change(k, electrons)`` alters the light k."""
    size = made.camera.size
    pattern = fixed_pattern(sensor, size, seed=sensor_seed)
    white_e = (sensor.white_level_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    gain = level * white_e / made.planes.max()
    frames = []
    for k, plane in enumerate(made.planes):
        light = plane * gain * texture
        light = light if change is None else change(k, light)
        frames += [
            _frame(light, sensor, (seed, k, repeat), pattern, "light", f"L{k:02d}")
            for repeat in range(repeats)
        ]
    frames += [
        _frame(0 * light, sensor, (seed, 999, repeat), pattern, "dark", "dark")
        for repeat in range(8)
    ]
    return Source(
        path,
        "images",
        tuple(frames),
        camera=made.camera,
        cfa=made.cfa,
        black_level=sensor.black_level_dn,
        white_level=sensor.white_level_dn,
        noise=sensor if model else None,
    )


def _frame(light, sensor, key, pattern, role, name):
    pixels = sensor_image(
        light.astype(np.float32), sensor, exposure_us=EXPOSURE_US, key=key, pattern=pattern
    )
    return Frame(NOWHERE / f"{name}.tif", name, pixels.shape, role, 0, EXPOSURE_US, lambda: pixels)


def gloss(made, size, roughness=0.3):
    """Return highlights ``(K, H, W)`` relative to the matte light, of a range ``size``.

    They have the distribution of Trowbridge and Reitz (1975).
    """
    points = made.camera.points_on_plane()
    light = np.asarray(made.lights.positions_mm)[:, None, None] - points
    light /= np.linalg.norm(light, axis=-1, keepdims=True)
    eye = made.camera.centre_mm - points
    half = light + eye / np.linalg.norm(eye, axis=-1, keepdims=True)
    square = half[..., 2] ** 2 / np.sum(half**2, axis=-1)
    lobe = (1 + square * (roughness**2 - 1)) ** -2 / light[..., 2]
    return lobe * size / np.ptp(lobe)


def rms(found, true):
    """Return the relative rms deviation, up to one factor."""
    ratio = found / true
    return float(np.std(ratio) / np.mean(ratio))
