"""How much of a network's result to use at each pixel, and how uncertain the blend is."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from processing._superres.interpolation import units

Float = npt.NDArray[np.float32]

# Roughness at which half of the network's result is used, in radians: fourth differences.
_HALF = 0.004
_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)
_LEAST = np.float32(1e-12)
# A blend is at most this much better than both results, in mean-square error.
_LEAST_SHARE = np.float32(0.25)


class Blend(NamedTuple):
    """A blend of two results.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` unit vectors.
    variance
        ``(H, W)`` mean-square error in radians squared.
    """

    normals: Float
    variance: Float


def roughness_gate(low: Float) -> Float:
    """Return, per pixel of a low resolution, the weight of a network where it is reliable, 0 to 1.

    Where a map is smooth, its fourth differences vanish, interpolation is exact, and there is
    nothing to add. Second differences would not do: those of steep waves are large.

    Parameters
    ----------
    low
        ``(h, w, 3)`` unit vectors.
    """
    rough = low
    for _ in range(2):
        smooth = cv2.sepFilter2D(rough, -1, _BINOMIAL, _BINOMIAL, borderType=cv2.BORDER_REFLECT_101)
        rough = rough - smooth
    energy = (rough**2).sum(axis=2)
    energy = cv2.blur(energy, (5, 5), borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(energy / (energy + _HALF**2), np.float32)


def blend(smooth: Float, sharp: Float, square: Float, errors: Float, gate: Float) -> Blend:
    """Blend an interpolation and the result of a network.

    The weight of the network is 1, less where it expects to be worse than bicubic interpolation
    (the ratio of the mean-square errors), and less where the map is smooth. With v_b and v_n the
    mean-square errors and r the difference of the results, the mean-square error of the blend with
    the weight w is (1 - w) v_b + w v_n - w (1 - w) r^2.

    Parameters
    ----------
    smooth, sharp
        ``(H, W, 3)`` unit vectors: an interpolation, and the result of the network.
    square
        ``(H, W)`` r^2, the squared distance of the network's result from bicubic interpolation.
    errors
        ``(H, W, 2)`` mean-square errors of the network's result and of bicubic interpolation.
    gate
        ``(H, W)`` largest weight, 0 to 1.
    """
    ours, theirs = errors[..., 0], errors[..., 1]
    weight = np.minimum(1, theirs / np.maximum(ours, _LEAST)) * gate
    variance = (1 - weight) * theirs + weight * ours - weight * (1 - weight) * square
    floor = _LEAST_SHARE * np.minimum(theirs, ours)
    normals = units(smooth + weight[..., None] * (sharp - smooth))
    return Blend(normals, np.asarray(np.maximum(variance, floor), np.float32))
