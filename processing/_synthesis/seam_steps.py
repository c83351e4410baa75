"""Angles between neighbouring normals, across cuts and inside patches."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

# Steps are measured on at most this many rows and columns, in the middle.
_MOST = 2048


class CutSteps(NamedTuple):
    """Mean angles between neighbouring normals in degrees; NaN if there are no such neighbours.

    Parameters
    ----------
    across_deg
        Across cuts: the two pixels belong to different patches.
    inside_deg
        Inside patches.
    """

    across_deg: float
    inside_deg: float

    @property
    def ratio(self) -> float:
        """``across_deg / inside_deg``: up to about 1, no cut is visible."""
        return self.across_deg / self.inside_deg if self.inside_deg else math.nan


def cut_steps(
    normals: npt.NDArray[np.float32], labels: npt.NDArray[np.uint8], *, wrapped: bool = False
) -> CutSteps:
    """Measure the steps between pixels of the same and of different labels.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit vectors, or 0 where there is no normal; of larger maps, the middle 2048 x
        2048 pixels are measured.
    labels
        ``(H, W)`` numbers of the patches.
    wrapped
        Also measure from the last column and row to the first.
    """
    height, width = labels.shape
    y, x = max(0, height - _MOST) // 2, max(0, width - _MOST) // 2
    part = slice(y, y + _MOST), slice(x, x + _MOST)
    normals, labels = normals[part], labels[part]
    if wrapped and (height, width) == labels.shape:
        normals = np.concatenate([normals, normals[:1]])
        normals = np.concatenate([normals, normals[:, :1]], axis=1)
        labels = np.concatenate([labels, labels[:1]])
        labels = np.concatenate([labels, labels[:, :1]], axis=1)
    sums, counts = _steps(np.ascontiguousarray(normals), np.ascontiguousarray(labels))
    totals, numbers = sums.sum(axis=0), counts.sum(axis=0)
    means = [math.degrees(t / n) if n else math.nan for t, n in zip(totals, numbers, strict=True)]
    return CutSteps(means[1], means[0])


@numba.njit(cache=True)
def _angle(a: npt.NDArray[np.float32], b: npt.NDArray[np.float32]) -> float:
    chord = 0.0
    for k in range(3):
        chord += (np.float64(a[k]) - b[k]) ** 2
    return 2 * math.asin(min(math.sqrt(chord) / 2, 1.0))


@numba.njit(parallel=True, cache=True)
def _steps(
    normals: npt.NDArray[np.float32], labels: npt.NDArray[np.uint8]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return sums of angles in rad and counts of each row, inside patches and across cuts."""
    rows, columns = labels.shape
    known = np.zeros(labels.shape, np.bool_)
    for r in numba.prange(rows):
        for c in range(columns):
            known[r, c] = normals[r, c, 0] != 0 or normals[r, c, 1] != 0 or normals[r, c, 2] != 0
    sums, counts = np.zeros((rows, 2)), np.zeros((rows, 2), np.int64)
    for r in numba.prange(rows):
        for c in range(columns):
            if not known[r, c]:
                continue
            if c + 1 < columns and known[r, c + 1]:
                kind = 0 if labels[r, c] == labels[r, c + 1] else 1
                sums[r, kind] += _angle(normals[r, c], normals[r, c + 1])
                counts[r, kind] += 1
            if r + 1 < rows and known[r + 1, c]:
                kind = 0 if labels[r, c] == labels[r + 1, c] else 1
                sums[r, kind] += _angle(normals[r, c], normals[r + 1, c])
                counts[r, kind] += 1
    return sums, counts
