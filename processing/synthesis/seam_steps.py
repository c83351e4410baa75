"""Angles between neighbouring normals, across cuts and inside patches."""

from __future__ import annotations

import math

import numba
import numpy as np

from acquisition import MapRows
from processing.detail.seam import SeamSteps
from rig import in_threads
from rig.arrays import AnyArray, Float32, Float64, Int64, UInt8
from rig.kernels import PART

# Compiled in: rig/kernels/parts.py 986f6e8c38a7

# Steps and figures are measured on at most this many rows and columns, in the middle.
MOST = 2048
# Rows that are read at once.
_READ = 128


def part_in_middle(values: MapRows, rows: slice | None = None) -> AnyArray:
    """Return at most 2048 x 2048 pixels in the middle of some rows of a map, or of all of them.

    The map may be on disk: a few of its rows are read at a time.
    """
    height, width = values.shape[:2]
    first, last, _ = (rows or slice(0, height)).indices(height)
    y, x = first + max(0, last - first - MOST) // 2, max(0, width - MOST) // 2
    last = min(y + MOST, last)
    parts = [values[top : min(top + _READ, last)][:, x : x + MOST] for top in range(y, last, _READ)]
    return np.concatenate(parts)


def cut_steps(normals: MapRows, labels: MapRows, *, wrapped: bool = False) -> SeamSteps:
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
    size = labels.shape
    normals, labels = part_in_middle(normals), part_in_middle(labels)
    if wrapped and size == labels.shape:
        normals = np.concatenate([normals, normals[:1]])
        normals = np.concatenate([normals, normals[:, :1]], axis=1)
        labels = np.concatenate([labels, labels[:1]])
        labels = np.concatenate([labels, labels[:, :1]], axis=1)
    rows = len(labels)
    sums, counts = np.zeros((rows, 2)), np.zeros((rows, 2), np.int64)
    normals, labels = np.ascontiguousarray(normals), np.ascontiguousarray(labels)
    in_threads(_steps, rows, normals, labels, sums, counts)
    totals, numbers = sums.sum(axis=0), counts.sum(axis=0)
    means = [math.degrees(t / n) if n else math.nan for t, n in zip(totals, numbers, strict=True)]
    return SeamSteps(means[1], means[0])


@numba.njit(**PART)
def _angle(a: Float32, b: Float32) -> float:
    chord = 0.0
    for k in range(3):
        chord += (np.float64(a[k]) - b[k]) ** 2
    return 2 * math.asin(min(math.sqrt(chord) / 2, 1.0))


@numba.njit(**PART)
def _known(normal: Float32) -> bool:
    return bool(normal[0] != 0 or normal[1] != 0 or normal[2] != 0)


@numba.njit(nogil=True, cache=True)
def _steps(
    first: int,
    last: int,
    normals: Float32,
    labels: UInt8,
    sums: Float64,
    counts: Int64,
) -> None:
    """Write sums of angles in rad and counts of each row, inside patches and across cuts."""
    rows, columns = labels.shape
    for r in range(first, last):
        for c in range(columns):
            if not _known(normals[r, c]):
                continue
            if c + 1 < columns and _known(normals[r, c + 1]):
                kind = 0 if labels[r, c] == labels[r, c + 1] else 1
                sums[r, kind] += _angle(normals[r, c], normals[r, c + 1])
                counts[r, kind] += 1
            if r + 1 < rows and _known(normals[r + 1, c]):
                kind = 0 if labels[r, c] == labels[r + 1, c] else 1
                sums[r, kind] += _angle(normals[r, c], normals[r + 1, c])
                counts[r, kind] += 1
