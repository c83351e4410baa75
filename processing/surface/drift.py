"""How a surface drifts from known heights: by errors that all normals have in common.

Lights that are not where they are assumed to be tilt all normals, and near ones bend the surface.
Point by point, known heights would only pull their surroundings to them, because independent errors
of normals have no such reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from rig.arrays import Bool, Float32, Float64, Int32, Int64

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
        ``(H, W)`` weights of known heights relative to those of edges.
    terms
        Number of terms of each part that drifts.
    """

    labels: Int32
    weights: Float32
    terms: dict[int, int]

    @classmethod
    def found(cls, off: Float64, weights: Float32, labels: Int32) -> Drift | None:
        """Return the drift that differences show clearly; None without any.

        Parameters
        ----------
        off
            ``(H, W)`` known height minus that of the surface without known heights, NaN elsewhere.
        weights, labels
            As above.
        """
        found = cls(labels, weights, {})
        for part in np.unique(labels[np.isfinite(off)]).tolist():
            terms, values = found._equations(off, labels == part)
            best, left = 1, _left_out(terms[:, :1], values)
            for count in _TERMS[1:]:
                more = _left_out(terms[:, :count], values)
                if more < _CLEARLY * left:
                    best, left = count, more
            if best > 1:
                found.terms[int(part)] = best
        return found if found.terms else None

    def of(self, off: Float64) -> Float64:
        """Return ``(H, W)`` the drift that differences at known heights show; 0 elsewhere."""
        drift = np.zeros(off.shape)
        for part, count in self.terms.items():
            inside = self.labels == part
            terms, values = self._equations(off, inside)
            factors = np.linalg.lstsq(terms[:, :count], values, rcond=None)[0]
            np.copyto(drift, _polynomial(factors.tolist(), off.shape), where=inside)
        return drift

    def _equations(self, off: Float64, inside: Bool) -> tuple[Float64, Float64]:
        """Return weighted terms ``(N, 6)`` and differences ``(N,)`` at known heights."""
        rows, columns = np.nonzero(inside & np.isfinite(off))
        weights = self.weights[rows, columns].astype(np.float64)
        # The surface has errors, too: the variance of the Green's function of a large grid.
        root = np.sqrt(weights / (1 + (np.log(max(off.shape)) + 1.6) / (2 * np.pi) * weights))
        y, x = (
            _along(at, size, off.shape) for at, size in zip((rows, columns), off.shape, strict=True)
        )
        terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
        return terms * root[:, None], off[rows, columns] * root


def _polynomial(factors: list[float], shape: tuple[int, ...]) -> Float64:
    """Return the polynomial of all pixels."""
    one, x, y, xx, xy, yy = [*factors, 0.0, 0.0, 0.0][:6]
    down, across = (_along(np.arange(size), size, shape) for size in shape)
    down = down[:, None]
    return np.asarray(one + x * across + xx * across**2 + down * (y + xy * across + yy * down))


def _along(at: Int64, size: int, shape: tuple[int, ...]) -> Float64:
    """Return places of pixels, -1 to 1 along the longer side."""
    return np.asarray((2 * at - size) / max(shape))


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
