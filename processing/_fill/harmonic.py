"""Smooth continuation of a shape into holes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._surface.multigrid import coarsened, solve

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_TOLERANCE = 1e-7


def harmonic_normals(normals: Float, known: Mask, holes: Mask) -> Float:
    """Continue unit vectors into holes, n_x and n_y as harmonic functions.

    Both solve Laplace's equation with the known vectors around the holes; where a hole meets pixels
    that are neither known nor in a hole, its border is free. The vectors of a sphere are continued
    exactly, because its n_x and n_y are linear functions of x and y. n_z is positive.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    known, holes
        ``(H, W)`` bool, without common pixels. Every connected part of the holes touches a known
        pixel.

    Returns
    -------
    Float
        ``(H, W, 3)`` float32: `normals`, with unit vectors in the holes.
    """
    rows, columns = np.flatnonzero(holes.any(axis=1)), np.flatnonzero(holes.any(axis=0))
    box = (
        slice(max(rows[0] - 1, 0), rows[-1] + 2),
        slice(max(columns[0] - 1, 0), columns[-1] + 2),
    )
    continued = normals.copy()
    continued[box] = _solved(normals[box], known[box], holes[box])
    return continued


def _solved(normals: Float, known: Mask, holes: Mask) -> Float:
    inside, given = np.pad(holes, 1), np.pad(known, 1)
    right, down = np.zeros(inside.shape, np.float32), np.zeros(inside.shape, np.float32)
    right[:, :-1] = inside[:, :-1] & inside[:, 1:]
    down[:-1] = inside[:-1] & inside[1:]
    fixed = np.pad(np.where(known[..., None], normals, 0), ((1, 1), (1, 1), (0, 0)))
    anchors, sums = np.zeros(inside.shape, np.float32), np.zeros((*inside.shape, 2))
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        anchors += np.roll(given, step, axis) & inside
        sums += np.roll(fixed[..., :2], step, axis) * inside[..., None]
    levels = coarsened(right, down, anchors)
    found = [
        solve(right, down, sums[..., k], anchors=anchors, levels=levels, tolerance=_TOLERANCE).u
        for k in (0, 1)
    ]
    x, y = (part[1:-1, 1:-1] for part in found)
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    vectors = np.dstack([x, y, z])
    vectors /= np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-30)
    return np.where(holes[..., None], vectors, normals).astype(np.float32)
