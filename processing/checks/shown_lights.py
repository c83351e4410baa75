"""The lights that images of a matte object show, compared with the given ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquisition import angle_deg
from processing.checks import limits
from processing.checks.block_model import BlockModel, solved
from rig import short_repr
from rig.arrays import Bool, Float64

_BLOCKS = 1500
_ROUNDS, _STEPS = 10, 3
# Darker samples, relative to the brightest of their block, may be in shadow.
_DARK = 0.1
_FEWEST_IMAGES, _FEWEST_CHECKED = 5, 8


@dataclass(frozen=True, eq=False)
class ShownLights:
    """Agreement of N images with their lights, and with any lights.

    Parameters
    ----------
    residual
        Median over the blocks of the rms deviation from a matte surface, relative to the signal.
    consistency
        The same under the lights that fit the images best, NaN with fewer than 5 images: matte
        images are linear combinations of three (Shashua, 1992).
    used
        Share of the samples that are neither saturated nor in shadow.
    image_residual
        ``(N,)`` median deviation of each image.
    error_deg, gain
        ``(N,)`` angle between each light and the one that its image shows, and the brightness of
        the image relative to its light; NaN if the object is too flat, or with fewer than 8 images.
    """

    residual: float
    consistency: float
    used: float
    image_residual: Float64
    error_deg: Float64
    gain: Float64

    __repr__ = short_repr

    @property
    def contradict(self) -> bool:
        """Whether the images show other lights than the given ones."""
        limit = max(limits.SHUFFLED_RESIDUAL, limits.SHUFFLED_FACTOR * self.consistency)
        far = np.isfinite(self.error_deg).all() and np.quantile(self.error_deg, 2 / 3)
        return bool(far > limits.SHUFFLED_DEG and self.residual > limit)


def shown_lights(model: BlockModel) -> ShownLights:
    """Fit the lights of all images to blocks whose normals are known, and then both in turn.

    Parameters
    ----------
    model
        The fit under the given lights.
    """
    count = model.samples.shape[1]
    some = np.flatnonzero(model.valid)
    some = some[:: max(1, -(-len(some) // _BLOCKS))]
    unknown = np.full(count, np.nan)
    if not len(some):
        return ShownLights(np.nan, np.nan, np.nan, unknown, unknown, unknown)
    seen, vectors = model.samples[some], model.vectors[some]
    measured = seen > 0
    usable = measured & (seen > _DARK * seen.max(axis=1, keepdims=True))
    signal = np.sqrt((usable * seen**2).sum(axis=1) / np.maximum(usable.sum(axis=1), 1))
    seen, normals = seen / signal[:, None], model.scaled_normals[some] / signal[:, None]
    off = np.where(usable, seen - (vectors @ normals[..., None])[..., 0], 0.0)
    error, gain = unknown, unknown
    consistency = np.nan
    if count >= _FEWEST_IMAGES:
        middle = vectors.mean(axis=0)
        aside = _lights(seen, vectors, normals, usable)
        relief = np.linalg.eigvalsh(normals.T @ normals / len(normals))
        if count >= _FEWEST_CHECKED and relief[0] > limits.LEAST_RELIEF**2 * relief[2]:
            moved = middle + aside
            gain = np.linalg.norm(moved, axis=1) / np.linalg.norm(middle, axis=1)
            error = np.asarray(angle_deg(moved, middle), np.float64)
        for _ in range(_ROUNDS):
            free = vectors + aside
            normals = solved(free, usable * _robust(seen, free, normals), seen)
            aside = _lights(seen, vectors, normals, usable)
        consistency = _relative(
            np.where(usable, seen - ((vectors + aside) @ normals[..., None])[..., 0], 0.0), usable
        )
    each = [
        float(np.median(np.abs(off[usable[:, k], k]))) if usable[:, k].any() else np.nan
        for k in range(count)
    ]
    return ShownLights(
        _relative(off, usable), consistency, float(usable.mean()), np.array(each), error, gain
    )


def _relative(off: Float64, usable: Bool) -> float:
    rms = np.sqrt((off**2).sum(axis=1) / np.maximum(usable.sum(axis=1), 1))
    return float(np.median(rms))


def _robust(seen: Float64, vectors: Float64, normals: Float64) -> Float64:
    off = np.abs(seen - (vectors @ normals[..., None])[..., 0])
    return np.asarray(1 / (1 + (off / max(2 * float(np.median(off)), 1e-6)) ** 2))


def _lights(seen: Float64, vectors: Float64, normals: Float64, usable: Bool) -> Float64:
    """Return the change ``(N, 3)`` of each light vector that explains most of its image."""
    off = np.where(usable, seen - (vectors @ normals[..., None])[..., 0], np.nan)
    squares = (normals[:, :, None] * normals[:, None, :]).reshape(-1, 9)
    weights, known = usable.astype(np.float64), usable.any(axis=0)
    found = np.zeros((seen.shape[1], 3))
    for _ in range(_STEPS):
        products = (weights.T @ squares).reshape(-1, 3, 3)
        ridge = 1e-9 * np.trace(products, axis1=1, axis2=2)[:, None, None] + 1e-12
        target = np.nan_to_num(weights * off).T @ normals
        found = np.linalg.solve(products + ridge * np.eye(3), target[..., None])[..., 0]
        left = np.abs(off - normals @ found.T)
        typical = np.ones(len(found))
        typical[known] = np.nanmedian(left[:, known], axis=0)
        weights = usable / (1 + (np.nan_to_num(left) / np.maximum(2 * typical, 1e-6)) ** 2)
    return np.asarray(found)
