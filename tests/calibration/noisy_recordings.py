"""Recordings of a radiance with the noise of a sensor, whose frames are arrays without files."""

from pathlib import Path

import numpy as np

from acquisition import Frame, NoiseModel, Source
from simulator.camera import sensor_image

SENSOR = NoiseModel(2.5, 2.5, 64.0, 12)
LONGEST_US = 20_000.0
# Exposures of three brackets, relative to the longest.
THREE = (1.0, 1 / 4, 1 / 16)


def frame(pixels, role="light", exposure_us=LONGEST_US, bracket=0, light_id="L00"):
    path = Path("/nowhere/frame.tif")
    return Frame(path, light_id, pixels.shape, role, bracket, exposure_us, lambda: pixels)


def recording(
    sensor, radiance, shares=(1.0,), repeats=1, seed=0, dark=True, ambient=0.0, model=True, cfa=None
):
    """Record a radiance, 1 at white in the longest exposure, with one dark frame per exposure."""
    white_e = (sensor.white_level_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    frames = []
    for b, share in enumerate(shares):
        time_us = LONGEST_US * share
        lit = np.asarray((radiance + ambient) * white_e * share, np.float32)
        for r in range(repeats):
            pixels = sensor_image(lit, sensor, exposure_us=time_us, key=(seed, b, r))
            frames.append(frame(pixels, exposure_us=time_us, bracket=b))
        if dark:
            unlit = np.full_like(lit, ambient * white_e * share)
            pixels = sensor_image(unlit, sensor, exposure_us=time_us, key=(seed, b, 99))
            frames.append(frame(pixels, "ambient" if ambient else "dark", time_us, b))
    return source(frames, sensor, noise=sensor if model else None, cfa=cfa)


def source(frames, sensor=SENSOR, **options):
    return Source(
        Path("/nowhere"),
        "images",
        tuple(frames),
        black_level=sensor.black_level_dn,
        white_level=sensor.white_level_dn,
        **options,
    )
