"""Pairs of low and high resolution that a network learns from."""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

import processing

Float = npt.NDArray[np.float32]
Domain = Literal["detail", "normals"]


def averaged(normals: Float, scale: int) -> Float:
    """Return normals as a sensor of lower resolution measures them.

    Parameters
    ----------
    normals
        ``(s h, s w, 3)`` unit vectors.
    scale
        Width of the squares that are averaged.

    Returns
    -------
    Float
        ``(h, w, 3)`` unit vectors.
    """
    height, width = normals.shape[0] // scale, normals.shape[1] // scale
    squares = normals.reshape(height, scale, width, scale, 3)
    return _unit(squares.mean(axis=(1, 3), dtype=np.float64))


def pair(normals: Float, scale: int, domain: Domain) -> tuple[Float, Float]:
    """Return the input of a network and the result that it should have.

    In the domain ``detail``, the input is the detail component of the low resolution, and the
    target the detail of the normals relative to the enlarged shape, R(S_up -> z) N. Combined with
    the enlarged shape, the target is therefore exactly the normals.

    Parameters
    ----------
    normals
        ``(s h, s w, 3)`` unit vectors at high resolution.
    scale
        Factor between the resolutions, 2 or 4.
    domain
        ``detail``, or ``normals`` for the normals themselves.

    Returns
    -------
    low, high
        ``(h, w, 3)`` and ``(s h, s w, 3)`` unit vectors.
    """
    low = averaged(normals, scale)
    if domain == "normals":
        return low, normals
    parts = processing.separate(processing.NormalMap.from_vectors(low))
    size = normals.shape[1::-1]
    shape = cv2.resize(parts.shape.normals, size, interpolation=cv2.INTER_CUBIC)
    high = processing.relative_detail(
        processing.NormalMap.from_vectors(normals), processing.NormalMap.from_vectors(shape)
    )
    return parts.detail.normals, high.normals


def _unit(vectors: npt.NDArray[np.floating]) -> Float:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True), np.float32)
