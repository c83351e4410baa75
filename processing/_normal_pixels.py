"""Compiled loops between the pixels of image files and normals."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# Larger components cannot belong to a unit vector, and their squares would overflow.
_LONGEST = 1000.0


@numba.njit(nogil=True, cache=True)
def encode(
    first: int, last: int, normals: Float, mask: Mask, green: float, out: npt.NDArray[np.uint16]
) -> None:
    """Write ``round((n / 2 + 0.5) * 65535)``, and z toward the camera outside a mask.

    Parameters
    ----------
    normals, mask
        ``(H, W, 3)`` vectors, 0 outside, and ``(H, W)``.
    green
        1, or -1 to invert the second channel.
    out
        ``(H, W, 3)``.
    """
    for r in range(first, last):
        for c in range(mask.shape[1]):
            x, y = np.float64(normals[r, c, 0]), np.float64(normals[r, c, 1])
            z = np.float64(normals[r, c, 2]) if mask[r, c] else 1.0
            out[r, c, 0] = np.uint16(np.rint((x * 0.5 + 0.5) * 65535))
            out[r, c, 1] = np.uint16(np.rint((y * (green * 0.5) + 0.5) * 65535))
            out[r, c, 2] = np.uint16(np.rint((z * 0.5 + 0.5) * 65535))


@numba.njit(cache=True)
def clear(vectors: Float, drawn: Mask) -> None:
    """Set ``(H, W, 3)`` vectors that are not finite or too long to 0, and write which are not 0."""
    for r in range(len(drawn)):
        for c in range(drawn.shape[1]):
            x, y, z = vectors[r, c, 0], vectors[r, c, 1], vectors[r, c, 2]
            # False for NaN.
            usable = abs(x) < _LONGEST and abs(y) < _LONGEST and abs(z) < _LONGEST
            if not usable:
                vectors[r, c, 0] = vectors[r, c, 1] = vectors[r, c, 2] = 0
            drawn[r, c] = usable and (x != 0 or y != 0 or z != 0)


@numba.njit(cache=True)
def lengths(vectors: Float, out: Float) -> None:
    """Write the lengths of ``(H, W, 3)`` vectors."""
    for r in range(len(out)):
        for c in range(out.shape[1]):
            x, y, z = vectors[r, c, 0], vectors[r, c, 1], vectors[r, c, 2]
            out[r, c] = np.sqrt(x * x + y * y + z * z)
