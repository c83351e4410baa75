"""Where a rendered image has edges: silhouettes and creases, and the edges of shadows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


def silhouettes(label: npt.NDArray[np.int16], depth_mm: Array, step_mm: Array | float) -> Mask:
    """Return the pixels on both sides of an edge between objects, and at steps of an object.

    Parameters
    ----------
    label
        ``(H, W)`` number of the object that a pixel shows.
    depth_mm
        ``(H, W)`` depth of what it shows.
    step_mm
        Second difference of the depth that counts as a step or a crease.
    """
    edge = _beside(label)
    step = np.broadcast_to(step_mm, depth_mm.shape)
    for axis in range(2):
        bend = np.abs(np.diff(depth_mm, 2, axis=axis))
        inner = [slice(None), slice(None)]
        inner[axis] = slice(1, -1)
        edge[tuple(inner)] |= bend > step[tuple(inner)]
    return edge


def shadow_edges(dark: Mask, label: npt.NDArray[np.int16]) -> Mask:
    """Return the pixels on both sides of an edge of one light's shadow, ``(H, W)`` like ``dark``.

    Edges between objects are left out.
    """
    return _beside(dark, label)


def _beside(
    values: npt.NDArray[np.int16] | Mask, same: npt.NDArray[np.int16] | None = None
) -> Mask:
    """Return the pixels with a neighbour of another value, and of the same object if given."""
    edge = np.zeros(values.shape, np.bool_)
    for axis in range(2):
        first: list[slice] = [slice(None), slice(None)]
        second: list[slice] = [slice(None), slice(None)]
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        one, two = tuple(first), tuple(second)
        differs = values[one] != values[two]
        if same is not None:
            differs &= same[one] == same[two]
        edge[one] |= differs
        edge[two] |= differs
    return edge
