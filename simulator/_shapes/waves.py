"""Plane waves of one wavelength in all directions, for noise, grain and varying paint."""

from __future__ import annotations

import math

import numba
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def random_waves(wavelength_mm: float, seed: int, count: int) -> Array:
    """Return ``(count, 3)`` wave numbers kx, ky (rad/mm) and phases of waves of one wavelength.

    The directions are uniform over the half circle plus a random offset, so that even a few waves
    look isotropic.
    """
    rng = np.random.default_rng(seed)
    angle = (np.arange(count) + rng.uniform(-0.5, 0.5, count)) * math.pi / count
    k = 2 * math.pi / wavelength_mm
    phase = rng.uniform(0, 2 * math.pi, count)
    return np.stack([k * np.cos(angle), k * np.sin(angle), phase], axis=1)


@numba.njit(nogil=True, cache=True)
def add_waves(
    first: int, last: int, x: Array, y: Array, waves: Array, gain: float, out: Array
) -> None:
    """Add the height and gradient of plane waves to ``out`` (3, n)."""
    for i in range(first, last):
        for j in range(len(waves)):
            kx, ky, phase = waves[j, 0], waves[j, 1], waves[j, 2]
            angle = kx * x[i] + ky * y[i] + phase
            slope = -gain * math.sin(angle)
            out[0, i] += gain * math.cos(angle)
            out[1, i] += kx * slope
            out[2, i] += ky * slope
