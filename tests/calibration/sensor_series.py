"""Simulated recordings of a lit card: exposures up to saturation, with repeats and dark frames."""

from pathlib import Path

import numpy as np

from acquisition import Frame, Source
from simulator.camera import fixed_pattern, sensor_image

LONGEST_US = 20_000.0


class Shown(Frame):
    """A frame without a file."""

    def read(self):
        return self.load()


def frame(pixels, role, time_us, bracket, light_id="L00", gain_db=0.0):
    path = Path(f"card/{role}_{time_us:g}us.tif")
    shape = pixels.shape
    return Shown(path, light_id, shape, role, bracket, time_us, lambda: pixels, gain_db=gain_db)


def card(
    sensor,
    seed,
    size=(240, 320),
    levels=21,
    top=1.25,
    repeats=2,
    darks=1,
    fall=0.0,
    filters=(1.0, 1.0, 1.0, 1.0),
    flicker=0.0,
    respond=lambda light: light,
    longest_us=LONGEST_US,
):
    """Return the frames of a card whose longest exposure is ``top`` times saturation.

    ``fall`` is the loss of light in the corners, ``filters`` the transmission of the 2 x 2 sites of
    a mosaic, ``respond`` the share of full scale that a share of light gives.
    """
    rows, columns = np.mgrid[: size[0], : size[1]]
    squared = (rows / size[0] - 0.5) ** 2 + (columns / size[1] - 0.5) ** 2
    field = 1 - 2 * fall * squared
    for site, transmission in enumerate(filters):
        field[site // 2 :: 2, site % 2 :: 2] *= transmission
    full_e = (sensor.converter_end_dn - sensor.black_level_dn) * sensor.electrons_per_dn
    full_e = min(full_e, sensor.full_well_e or full_e)
    pattern = fixed_pattern(sensor, size, seed=seed)
    lamps = np.random.default_rng(seed)
    frames = []
    for level in range(levels):
        share = (level + 1) / levels * top
        time_us = longest_us * share / top
        for k in range(repeats):
            lamp = 1 + flicker * lamps.standard_normal()
            lit = (full_e * respond(field * share * lamp)).astype(np.float32)
            key = (seed, level, k)
            pixels = sensor_image(lit, sensor, exposure_us=time_us, key=key, pattern=pattern)
            frames.append(frame(pixels, "light", time_us, level))
        for k in range(darks):
            key = (seed, level, 1000 + k)
            unlit = np.zeros(size, np.float32)
            pixels = sensor_image(unlit, sensor, exposure_us=time_us, key=key, pattern=pattern)
            frames.append(frame(pixels, "dark", time_us, level))
    return source(frames, sensor)


def source(frames, sensor, **options):
    end_dn = sensor.converter_end_dn
    return Source(Path("card"), "session", tuple(frames), white_level=end_dn, **options)
