"""Shading of known normals under known lights."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._stereo.light_model import LightModel

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Double = npt.NDArray[np.float64]


def shading(model: LightModel, normals: Float, mask: Mask, rows: slice) -> Double:
    """Return ``max(l . n, 0)`` of some rows, ``(N, R, W)``; 0 outside the mask.

    It is 0 too where a near light does not reach the surface.
    """
    inside = mask[rows]
    pixels = np.flatnonzero(inside) + (rows.start or 0) * inside.shape[1]
    vectors = model.vectors(pixels)
    known = normals[rows][inside].astype(np.float64)
    spread = np.broadcast_to(vectors, (len(pixels), *vectors.shape[1:]))
    result = np.zeros((vectors.shape[2], *inside.shape))
    result[:, inside] = np.maximum(np.einsum("pc,pcn->np", known, spread), 0)
    return result
