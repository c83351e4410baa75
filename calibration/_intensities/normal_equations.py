"""Normal equations of the strengths, with the albedo of each block eliminated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calibration._intensities.surface import Array


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Weighted least squares for C channels, K lights and columns shared by the channels.

    Unknown ``c * K + k`` is the strength of light k in channel c; ``C * K + j * K + k`` is column j
    of light k.

    Parameters
    ----------
    matrix
        ``(n, n)``.
    right
        ``(n,)``.
    scores
        ``(n, P)`` contributions of the blocks to `right`; None if they were not requested.
    """

    matrix: Array
    right: Array
    scores: Array | None

    @classmethod
    def of(
        cls, residuals: Array, weights: Array, columns: Array, *, scores: bool = False
    ) -> NormalEquations:
        """Build them from residuals and weights ``(C, K, P)`` and columns ``(J, K, P)``."""
        channels, lights, blocks = residuals.shape
        width = 1 + len(columns)
        size = (channels + width - 1) * lights
        matrix, right = np.zeros((size, size)), np.zeros(size)
        found = np.zeros((size, blocks)) if scores else None
        extended = np.concatenate([np.ones((1, lights, blocks)), columns])
        for c in range(channels):
            weight, residual = weights[c], residuals[c]
            total = weight.sum(axis=0)
            total = np.where(total > 0, total, 1.0)
            loaded = extended * weight
            block = -_product(loaded.reshape(width * lights, blocks), total)
            for k in range(lights):
                own = np.ix_(np.arange(width) * lights + k, np.arange(width) * lights + k)
                block[own] += loaded[:, k] @ extended[:, k].T
            rest = residual - (weight * residual).sum(axis=0) / total
            score = (loaded * rest).reshape(width * lights, blocks)
            place = np.concatenate(
                [
                    c * lights + np.arange(lights),
                    channels * lights + np.arange((width - 1) * lights),
                ]
            )
            matrix[np.ix_(place, place)] += block
            right[place] += score.sum(axis=1)
            if found is not None:
                found[place] += score
        return cls(matrix, right, found)


def _product(loaded: Array, total: Array) -> Array:
    product: Array = (loaded / total) @ loaded.T
    return product
