"""Images of an object at reduced resolution, and what normals and albedo of each block predict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from acquisition import Lights
from processing.checks import limits
from processing.images.block_means import Cells
from rig import short_repr
from rig.arrays import Bool, Float64, Intp

# Noise of a block mean: a share of the largest signal, and of the sample.
_NOISE, _RELATIVE_NOISE = 0.002, 0.01
_STEPS = 5
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class BlockModel:
    """P blocks of N images under given light vectors, and their robust fit.

    Parameters
    ----------
    samples
        ``(P, N)`` linear radiance relative to the bright parts of the object; 0 if not measured.
    vectors
        ``(P, N, 3)`` light vectors.
    points
        ``(P, 3)`` surface points.
    places
        ``(P,)`` flat indices of the blocks in the grid.
    shape
        Size of the grid.
    scaled_normals
        ``(P, 3)`` normals times albedo.
    predicted
        ``(P, N)`` what these predict; 0 in attached shadow.
    weights
        ``(P, N)`` reciprocal variances times robust weights; 0 where a sample does not count.
    attached
        ``(P, N)`` bool, samples in attached shadow: light there is ambient or an offset.
    variance
        ``(P, N)`` of the samples.
    valid
        ``(P,)`` bool, blocks with enough samples.
    """

    samples: Float64
    vectors: Float64
    points: Float64
    places: Intp
    shape: tuple[int, int]
    scaled_normals: Float64
    predicted: Float64
    weights: Float64
    attached: Bool
    variance: Float64
    valid: Bool

    __repr__ = short_repr

    @cached_property
    def albedo(self) -> Float64:
        """``(P,)``."""
        return np.asarray(np.maximum(np.linalg.norm(self.scaled_normals, axis=1), 1e-9))

    @cached_property
    def normals(self) -> Float64:
        """``(P, 3)``."""
        return np.asarray(self.scaled_normals / self.albedo[:, None])

    def products(self, blocks: Intp) -> tuple[Float64, Float64]:
        """Return the weighted vectors ``(B, N, 3)`` of blocks, and their products ``(B, 3, 3)``."""
        vectors = np.where(self.attached[blocks][..., None], 0.0, self.vectors[blocks])
        weighted = vectors * self.weights[blocks][..., None]
        products = weighted.transpose(0, 2, 1) @ vectors
        ridge = 1e-9 * np.trace(products, axis1=1, axis2=2)[:, None, None] + 1e-30
        return weighted, products + ridge * np.eye(3)

    def answer(self, blocks: Intp, change: Float64) -> Float64:
        """Return how the scaled normals ``(B, 3)`` of blocks change if samples ``(B, N)`` do."""
        weighted, products = self.products(blocks)
        target = (weighted * change[..., None]).sum(axis=1)
        return np.asarray(np.linalg.solve(products, target[..., None])[..., 0])

    @property
    def relative_residual(self) -> float:
        """Typical residual relative to the brightest sample of its block."""
        counted = (self.weights > 0) & self.valid[:, None]
        brightest = np.maximum(self.predicted.max(axis=1, keepdims=True), 1e-6)
        off = np.abs(self.samples - self.predicted) / brightest
        return _MAD_TO_SIGMA * float(np.median(off[counted]))


class Blocks:
    """Blocks of a recording.

    Parameters
    ----------
    cells
        Means of the N images, divided by the strengths of the lights.
    pixel_mm
        Size of a pixel on the object; None if it is not known.

    Attributes
    ----------
    samples
        ``(P, N)`` radiance relative to the bright parts of the object, NaN where not measured.
    places
        ``(P,)`` flat indices of the blocks in the grid of this ``shape``.
    points
        ``(P, 3)`` surface points in mm, in blocks of a pixel without a scale.
    """

    def __init__(self, cells: Cells, pixel_mm: float | None) -> None:
        self.cells = cells
        self.shape, self.size, self.top = cells.mask.shape, cells.size, cells.corner[0]
        self.places: Intp = np.flatnonzero(cells.mask)
        values = cells.values.reshape(len(cells.values), -1)[:, self.places].T.astype(np.float64)
        measured = values[np.isfinite(values)]
        self.scale = max(float(np.percentile(measured, 99)), 1e-12) if measured.size else 1.0
        self.samples: Float64 = values / self.scale
        if cells.points_mm is not None:
            self.points = cells.points_mm.reshape(-1, 3)[self.places]
            return
        rows, across = np.divmod(self.places, self.shape[1])
        flat = [across - across.mean(), rows.mean() - rows, np.zeros(len(rows))]
        self.points = np.stack(flat, axis=1) * self.size * (pixel_mm or 1.0)

    __repr__ = short_repr

    def fit(
        self, lights: Lights, without: Sequence[int] = (), samples: Float64 | None = None
    ) -> BlockModel:
        """Return the fit under these lights, without some images, or of other samples."""
        samples = self.samples.copy() if samples is None else samples
        samples[:, list(without)] = np.nan
        vectors = light_vectors(lights, self.points)
        return fit_blocks(samples, vectors, self.points, self.places, self.shape)


def light_vectors(lights: Lights, points: Float64) -> Float64:
    """Return light vectors ``(P, N, 3)`` at points ``(P, 3)``."""
    return np.ascontiguousarray(np.moveaxis(lights.vectors_at(points), 0, 1))


def fit_blocks(
    samples: Float64, vectors: Float64, points: Float64, places: Intp, shape: tuple[int, int]
) -> BlockModel:
    """Fit normals and albedo to each block by iteratively reweighted least squares.

    Parameters
    ----------
    samples
        ``(P, N)`` radiance, NaN where not measured.
    vectors
        ``(P, N, 3)`` light vectors.
    points, places, shape
        As in `BlockModel`.
    """
    measured = np.isfinite(samples)
    seen = np.where(measured, samples, 0.0)
    weights = measured.astype(np.float64)
    count = samples.shape[1]
    for _ in range(_STEPS):
        scaled = solved(vectors, weights, seen)
        predicted = (vectors @ scaled[..., None])[..., 0]
        brightest = np.maximum(predicted.max(axis=1, keepdims=True), 1e-6)
        lit = measured & (predicted > limits.DIM * brightest)
        attached = measured & (predicted < -limits.ATTACHED * brightest)
        cast = (seen < limits.CAST * predicted) & (predicted > 3 * limits.DIM * brightest)
        variance = _NOISE**2 + (_RELATIVE_NOISE * np.maximum(predicted, 0)) ** 2
        off = np.abs(seen - np.where(attached, 0.0, predicted)) / np.sqrt(variance)
        # The median of the lit ones: others are sorted behind them.
        middle = np.maximum(lit.sum(axis=1, keepdims=True) // 2, 0)
        ordered = np.sort(np.where(lit, off, np.inf), axis=1)
        spread = np.take_along_axis(ordered, np.minimum(middle, count - 1), axis=1)
        spread = np.clip(_MAD_TO_SIGMA * spread, 0.3, 1e6)
        variance = variance * spread**2
        robust = np.minimum(1, limits.HUBER * spread / np.maximum(off, 1e-9)) / variance
        enough = (lit & ~cast).sum(axis=1) >= min(6, count - 1)
        weights = np.where(lit & ~cast & enough[:, None], robust, 0.0)
        weights[~enough] = 1e-9
    weights = np.where(attached & enough[:, None], robust, weights)
    return BlockModel(
        seen, vectors, points, places, shape, scaled, np.where(attached, 0.0, predicted),
        np.where(enough[:, None], weights, 0.0), attached, variance, enough,
    )  # fmt: skip


def solved(vectors: Float64, weights: Float64, samples: Float64) -> Float64:
    """Return the scaled normals ``(P, 3)`` of least squares."""
    weighted = vectors * weights[..., None]
    products = weighted.transpose(0, 2, 1) @ vectors
    target = (weighted * samples[..., None]).sum(axis=1)
    ridge = 1e-9 * np.trace(products, axis1=1, axis2=2)[:, None, None] + 1e-30
    return np.asarray(np.linalg.solve(products + ridge * np.eye(3), target[..., None])[..., 0])
