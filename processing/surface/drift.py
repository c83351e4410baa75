"""How a surface drifts from known heights: by errors that all normals have in common.

Lights that are not where they are assumed to be tilt all normals, and near ones bend the surface.
Point by point, known heights would only pull their surroundings to them, because independent errors
of normals have no such reach.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from rig.arrays import Float32, Float64, Int32, Int64

# Terms of a plane and a quadratic surface.
_TERMS: Final = (2, 5)
# A higher order predicts each known height from the others to this share of the deviation that the
# lower one leaves. Errors without a pattern leave more than half; a step leaves a quarter if all
# heights are far from it.
_CLEARLY: Final = 0.2
_NO_SHARE: Final = 1e-9


@dataclass(frozen=True, eq=False)
class Drift:
    """A polynomial that all pieces of a surface share; their mean heights are no drift.

    Parameters
    ----------
    pieces
        ``(H, W)`` piece of each pixel, -1 outside.
    weights
        ``(H, W)`` weights of known heights relative to those of edges.
    terms
        Number of terms.
    """

    pieces: Int32
    weights: Float32
    terms: int = 0

    @classmethod
    def found(cls, off: Float64, weights: Float32, pieces: Int32) -> Drift | None:
        """Return the drift that differences show clearly; None without any.

        Parameters
        ----------
        off
            ``(H, W)`` known height minus that of the surface without known heights, NaN elsewhere.
        weights, pieces
            As above.
        """
        none = cls(pieces, weights)
        terms, values, alone = none._equations(off)
        best, left = 0, _left_out(terms[:, :0], values, alone)
        for count in _TERMS:
            more = _left_out(terms[:, :count], values, alone)
            if more < _CLEARLY * left:
                best, left = count, more
        return replace(none, terms=best) if best else None

    def of(self, off: Float64) -> Float64:
        """Return ``(H, W)`` the drift that differences at known heights show."""
        terms, values, _ = self._equations(off)
        factors = np.linalg.lstsq(terms[:, : self.terms], values, rcond=None)[0]
        x, y, xx, xy, yy = [*factors.tolist(), 0.0, 0.0, 0.0][:5]
        down, across = (_along(np.arange(size), size, off.shape) for size in off.shape)
        down = down[:, None]
        return np.asarray(x * across + xx * across**2 + down * (y + xy * across + yy * down))

    def _equations(self, off: Float64) -> tuple[Float64, Float64, Float64]:
        """Return weighted terms ``(N, 5)``, differences ``(N,)``, and what others determine.

        Terms and differences are relative to their means over the known heights of the piece; to
        these means, each height itself contributes the rest of 1 (the third array).
        """
        rows, columns = np.nonzero((self.pieces >= 0) & np.isfinite(off))
        weights = self.weights[rows, columns].astype(np.float64)
        # The surface has errors, too: the variance of the Green's function of a large grid.
        weights /= 1 + (np.log(max(off.shape)) + 1.6) / (2 * np.pi) * weights
        y, x = (
            _along(at, size, off.shape) for at, size in zip((rows, columns), off.shape, strict=True)
        )
        every = np.stack([x, y, x * x, x * y, y * y, off[rows, columns]], axis=1)
        piece = np.unique(self.pieces[rows, columns], return_inverse=True)[1]
        totals = np.bincount(piece, weights)
        means = np.stack([np.bincount(piece, weights * each) for each in every.T]) / totals
        every = (every - means.T[piece]) * np.sqrt(weights)[:, None]
        alone = 1 - weights / totals[piece]
        related = alone > _NO_SHARE
        return every[related, :-1], every[related, -1], alone[related]


def _along(at: Int64, size: int, shape: tuple[int, ...]) -> Float64:
    """Return places of pixels, -1 to 1 along the longer side."""
    return np.asarray((2 * at - size) / max(shape))


def _left_out(design: Float64, values: Float64, alone: Float64) -> float:
    """Return the rms error of predictions of each value from the others; infinite if one is not."""
    if len(design) <= design.shape[1]:
        return np.inf
    if design.shape[1]:
        basis, size, _ = np.linalg.svd(design, full_matrices=False)
        basis = basis[:, size > 1e-9 * size[0]]
        alone = alone - np.square(basis).sum(axis=1)
        values = values - basis @ (basis.T @ values)
    if alone.min() < _NO_SHARE:
        return np.inf
    return float(np.sqrt(np.mean(np.square(values / alone))))
