"""How a surface drifts from known heights: by errors that all normals have in common.

Lights that are not where they are assumed to be tilt all normals, and near ones bend the surface.
Point by point, known heights would only pull their surroundings to them, because independent errors
of normals have no such reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rig.arrays import Float64, Int32, Int64

# Terms of a mean, a plane and a quadratic surface.
_TERMS: Final = (1, 3, 6)
# A higher order predicts each known height from the others to this share of the deviation that the
# lower one leaves. Errors without a pattern leave more than half; a step leaves a quarter if all
# heights are far from it.
_CLEARLY: Final = 0.2


@dataclass(frozen=True, eq=False)
class Drift:
    """Polynomials of the parts of a surface.

    Parameters
    ----------
    labels
        ``(H, W)`` part of each pixel, -1 outside.
    weights
        ``(H, W)`` reciprocal variances of known heights less those of a surface.
    terms
        Number of terms of each part that drifts.
    """

    labels: Int32
    weights: Float64
    terms: dict[int, int]

    @classmethod
    def found(cls, off: Float64, weights: Float64, labels: Int32) -> Drift | None:
        """Return the drift that differences show clearly; None without any.

        Parameters
        ----------
        off
            ``(H, W)`` known height minus that of the surface without known heights, NaN elsewhere.
        weights, labels
            As above.
        """
        terms = {}
        known = np.isfinite(off)
        for part in np.unique(labels[known]).tolist():
            rows, columns = np.nonzero(known & (labels == part))
            root = np.sqrt(weights[rows, columns])
            values = off[rows, columns] * root
            best, left = 1, _left_out(np.ones((len(rows), 1)) * root[:, None], values)
            for count in _TERMS[1:]:
                design = _terms(rows, columns, labels.shape, count) * root[:, None]
                more = _left_out(design, values)
                if more < _CLEARLY * left:
                    best, left = count, more
            if best > 1:
                terms[int(part)] = best
        return cls(labels, weights, terms) if terms else None

    def of(self, off: Float64) -> Float64:
        """Return ``(H, W)`` the drift that differences at known heights show; 0 elsewhere."""
        drift = np.zeros(off.shape)
        for part, count in self.terms.items():
            inside = self.labels == part
            rows, columns = np.nonzero(inside & np.isfinite(off))
            root = np.sqrt(self.weights[rows, columns])
            design = _terms(rows, columns, off.shape, count) * root[:, None]
            factors = np.linalg.lstsq(design, off[rows, columns] * root, rcond=None)[0]
            rows, columns = np.nonzero(inside)
            drift[inside] = _terms(rows, columns, off.shape, count) @ factors
        return drift


def _terms(rows: Int64, columns: Int64, shape: tuple[int, ...], count: int) -> Float64:
    y, x = ((2 * at - size) / max(shape) for at, size in zip((rows, columns), shape, strict=True))
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)[:, :count]


def _left_out(design: Float64, values: Float64) -> float:
    """Return the rms error of predictions of each value from the others; infinite if one is not."""
    if len(design) <= design.shape[1]:
        return np.inf
    basis, size, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, size > 1e-9 * size[0]]
    alone = 1 - np.square(basis).sum(axis=1)
    if alone.min() < 1e-9:
        return np.inf
    return float(np.sqrt(np.mean(np.square((values - basis @ (basis.T @ values)) / alone))))
