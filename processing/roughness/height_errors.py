"""Errors of heights inside a window, from those of the normals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dctn, idctn

from processing.maps.normal_map import NormalMap
from processing.surface.curl import normal_curl
from rig import short_repr
from rig.arrays import Bool, Float32, Float64, Floating

# Steeper normals (beyond 84 degrees) have no slopes that could be used.
_LEAST_NZ = 0.1
_SEED = 46


@dataclass(frozen=True, eq=False)
class NormalErrors:
    """Normals of a window and how sure they are.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit vectors, 0 outside the mask.
    sigma_deg
        ``(H, W)`` standard deviation: root mean square angle to the true normal.
    common_deg
        The part that all pixels have in common.
    """

    normals: Float32
    sigma_deg: Float32
    common_deg: float

    __repr__ = short_repr

    def cropped(self, window: tuple[slice, slice]) -> NormalErrors:
        """Return those of a window."""
        return NormalErrors(self.normals[window], self.sigma_deg[window], self.common_deg)

    @cached_property
    def _own(self) -> Float32:
        """Standard deviation of each normal in each tangent direction without the common part.

        Normals whose deviation is not known count as the least certain one.
        """
        known = np.isfinite(self.sigma_deg)
        largest = self.sigma_deg[known].max() if known.any() else np.float32(0)
        sigma_deg = np.where(known | ~self.normals.any(axis=2), self.sigma_deg, largest)
        variance = np.square(np.radians(sigma_deg)) - math.radians(self.common_deg) ** 2
        return np.sqrt(np.maximum(np.nan_to_num(variance), 0) / 2)

    @cached_property
    def noise_share(self) -> float:
        """Share of the deviations, 0 to 1, that is independent from pixel to pixel.

        The curl of the normals shows it: it is 0 for every surface, and errors that neighbours have
        in common, such as those of the blur of steep relief, hardly change it.
        """
        mask = np.asarray(self.normals.any(axis=2))
        normals = NormalMap.of_unit_vectors(self.normals, mask)
        sigma_deg = np.degrees(self._own * math.sqrt(2)).astype(np.float32)
        excess = normal_curl(normals, sigma_deg=sigma_deg).excess
        return min(excess, 1.0) if math.isfinite(excess) else 1.0

    def noise(self, pixel: float, count: int) -> Iterator[Floating]:
        """Yield ``(H, W)`` errors of heights, in the unit of a pixel, by noise.

        Parameters
        ----------
        pixel
            Distance between neighbouring pixels.
        count
            Number of maps.
        """
        yield from self._turned(self.noise_share, pixel, count, 0)

    def model(self, pixel: float, count: int) -> Iterator[Floating]:
        """Yield the same by what else the deviations contain: errors of the model of the images."""
        share = math.sqrt(1 - self.noise_share**2)
        if share > 0:
            yield from self._turned(share, pixel, count, 1)

    def _turned(self, share: float, pixel: float, count: int, kind: int) -> Iterator[Floating]:
        deviation = (np.float32(share) * self._own)[..., None].astype(np.float32)
        for number in range(count):
            rng = np.random.default_rng([_SEED, kind, number])
            turned = deviation * rng.standard_normal(self.normals.shape, np.float32)
            yield self._integrated(self.normals + turned, pixel)

    def lights(self, pixel: float) -> Iterator[Floating]:
        """Yield errors of heights by one standard deviation of each independent error of lights.

        If lights are not where they are assumed to be, or not as strong, a matte surface has the
        normals ``(1 + E) n`` before they are given unit length, with E the product of the
        pseudo-inverse of the light vectors and their errors. Two entries of E tilt a flat surface;
        others stretch slopes, which no form removes. E is not known; independent entries of equal
        deviation give a flat surface the stated common error.
        """
        deviation = math.radians(self.common_deg) / math.sqrt(2)
        if deviation == 0:
            return
        for row in range(3):
            for column in range(3):
                # A common factor of all entries of the diagonal changes nothing.
                entry = np.zeros((3, 3))
                entry[row, column] = deviation
                moved = self.normals @ (np.eye(3) + entry).T.astype(np.float32)
                yield self._integrated(moved, pixel)

    def _integrated(self, moved: Float32, pixel: float) -> Floating:
        """Return the change of the height by that of the normals, ``(H, W)``."""
        usable = (self.normals[..., 2] > _LEAST_NZ) & (moved[..., 2] > _LEAST_NZ)
        right, up = (
            _slope(moved, axis, usable) - _slope(self.normals, axis, usable) for axis in (0, 1)
        )
        return pixel * integrated(right, -up)


def _slope(normals: Float32, axis: int, usable: Bool) -> Float32:
    return np.where(usable, -normals[..., axis] / np.where(usable, normals[..., 2], 1), 0)


def integrated(right: Floating, down: Floating) -> Floating:
    """Return heights in pixels whose slopes fit the given ones best, with a mean of 0.

    The cosine transform solves the Poisson equation with free borders (Frankot and Chellappa, 1988;
    Simchony, Chellappa and Shao, 1990).
    """
    divergence = np.zeros_like(right)
    across = (right[:, :-1] + right[:, 1:]) / 2
    along = (down[:-1] + down[1:]) / 2
    divergence[:, 1:] += across
    divergence[:, :-1] -= across
    divergence[1:] += along
    divergence[:-1] -= along
    spectrum = dctn(divergence, overwrite_x=True)
    rows, columns = (_laplacian(size) for size in right.shape)
    inverse = (rows[:, None] + columns[None]).astype(right.dtype)
    inverse[0, 0] = 1
    spectrum /= inverse
    spectrum[0, 0] = 0
    return np.asarray(idctn(spectrum, overwrite_x=True), right.dtype)


def _laplacian(size: int) -> Float64:
    return np.asarray(2 - 2 * np.cos(np.pi * np.arange(size) / size))
