"""Reference solutions of blocks of pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from acquisition import CameraModel, Lights
from processing.noise.light_table import ERRORS, light_table
from processing.noise.reference import PARTS, reference_solutions
from processing.noise.sample_judgement import LIT
from processing.noise.sample_kind import SampleKind
from rig import in_threads
from rig.arrays import Float32, Float64, Intp, UInt8, UInt16

# With fewer lights the nearest one is far away, and a highlight is in one image only.
_FEWEST_LIGHTS = 8
_FEWEST_PIXELS = 100
_BLOCK = 16384
_LEAST_SCALE = 1e-6


class ReferenceSolver:
    """Solves pixels again, from given normals.

    Parameters
    ----------
    lights
        The N lights.
    scaled
        Given normals ``(H, W, 3)`` and albedo ``(H, W)``; 0 for pixels that are not solved. They
        may be filled after the solver is made.
    points_mm, camera, depth_sigma
        As in `normal_uncertainty`.
    """

    def __init__(
        self,
        lights: Lights,
        scaled: tuple[Float32, Float32],
        points_mm: Float64 | None,
        camera: CameraModel | None,
        depth_sigma: float,
    ) -> None:
        self._near = lights.near
        self._table = light_table(lights)
        self._width = scaled[1].shape[1]
        self._normals, self._albedo = scaled[0].reshape(-1, 3), scaled[1].reshape(-1)
        self._points = np.zeros((1, 3))
        if points_mm is not None and lights.near:
            self._points = np.ascontiguousarray(points_mm, np.float64).reshape(-1, 3)
        self._view = np.zeros(4)
        if camera is not None and lights.near:
            self._view[:] = *camera.centre_mm, depth_sigma
        self._errors = bool(self._table[ERRORS].any() or self._view[3] > 0)

    def solve(
        self,
        pixels: Intp,
        samples: Float32,
        vectors: Float32,
        law: Float32 | None,
        *,
        keep_kinds: bool = True,
    ) -> tuple[UInt8, UInt16, Float64, Float32]:
        """Return kinds, their numbers, references and variances of some pixels.

        See `reference_solutions`. Without a law, all samples have the same unknown variance. The
        kinds are ``(0, N)`` if they are not kept, which is faster.
        """
        kinds = np.zeros((len(samples) if keep_kinds else 0, samples.shape[1]), np.uint8)
        counts = np.zeros((len(pixels), len(SampleKind)), np.uint16)
        reference = np.zeros((len(pixels), 3))
        parts = np.zeros((len(pixels), PARTS), np.float32)
        wide = np.zeros((1, 2, samples.shape[1]), np.float32)
        wide[:, 0] = 1
        if law is not None:
            wide = np.broadcast_to(law, (len(law), 2, samples.shape[1]))
            # A kernel is compiled again for arrays that cannot be written.
            wide = np.require(law if law.shape == wide.shape else wide, requirements=("C", "W"))
        starts = _row_starts(pixels, self._width)
        in_threads(
            reference_solutions,
            len(starts) - 1,
            samples,
            vectors,
            wide,
            self._normals,
            self._albedo,
            np.float32(_LEAST_SCALE if law is None else 1.0),
            self._table,
            self._errors and law is not None,
            self._near,
            self._points,
            self._view,
            np.ascontiguousarray(pixels),
            starts,
            kinds,
            counts,
            reference,
            parts,
        )
        return kinds, counts, reference, parts

    def correlation(
        self, pixels: Intp, samples: Float32, vectors: Float32, law: Float32 | None
    ) -> float:
        """Return how alike the residuals of neighbouring lights are at some pixels."""
        kinds, _, reference, _ = self.solve(pixels, samples, vectors, law)
        return neighbour_correlation(samples, vectors, kinds, reference)


def row_blocks(pixels: Intp, width: int) -> Iterator[Intp]:
    """Yield complete rows of pixels, about 16,000 pixels at once."""
    starts = _row_starts(pixels, width)
    at = np.unique(np.searchsorted(starts, np.arange(0, len(pixels) + _BLOCK, _BLOCK)))
    chosen = starts[np.minimum(at, len(starts) - 1)]
    for first, last in pairwise(chosen):
        if last > first:
            yield pixels[first:last]


def _row_starts(pixels: Intp, width: int) -> Intp:
    """Return where rows of the image begin in a list of pixels, and its length."""
    inside = np.flatnonzero(np.diff(pixels // width)) + 1
    return np.concatenate([[0], inside, [len(pixels)]]).astype(np.intp)


def neighbour_correlation(
    values: Float32, vectors: Float32, kinds: UInt8, reference: Float64
) -> float:
    """Return the correlation between the residuals of each light and of the one nearest to it.

    Noise and errors of lights are independent from light to light; the fit makes their correlation
    slightly negative. A surface that is not matte reflects neighbouring lights in a similar
    way, and the correlation is positive, whatever the strength of the noise. NaN if there are too
    few lights or pixels.

    Parameters
    ----------
    values, vectors
        Samples of P pixels, see `LightModel.samples`.
    kinds, reference
        See `reference_solutions`.
    """
    solved = np.isfinite(reference).all(axis=1)
    of_pixel = np.broadcast_to(vectors, (len(values), *vectors.shape[1:]))[solved]
    predicted = np.einsum("pc,pcn->pn", reference[solved], of_pixel)
    residuals = np.where(kinds[solved] == LIT, np.nan_to_num(values[solved]) - predicted, 0.0)
    return correlation_of_neighbours(residuals, vectors.mean(axis=0).T)


def correlation_of_neighbours(residuals: Float64, vectors: Float64) -> float:
    """Return the correlation between the residuals of each light and of the one nearest to it.

    Parameters
    ----------
    residuals
        ``(P, N)``, 0 where a sample is missing.
    vectors
        ``(N, 3)`` light vectors in the middle of the object.

    Returns
    -------
    float
        NaN if there are too few lights or pixels.
    """
    if len(vectors) < _FEWEST_LIGHTS or len(residuals) < _FEWEST_PIXELS:
        return math.nan
    units = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-30)
    cosines = units @ units.T
    np.fill_diagonal(cosines, -2)
    nearest = np.argmax(cosines, axis=1)
    squares = (residuals**2).sum(axis=1)
    products = (residuals * residuals[:, nearest]).sum(axis=1)
    structured = squares > 0
    if not structured.any():
        return math.nan
    return float(np.mean(products[structured] / squares[structured]))
