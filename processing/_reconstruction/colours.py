"""Normals from images in colour, one solution per channel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from calibration import StackNoise, luma
from processing._reconstruction.colour_maps import ColourImages, ColourMaps
from processing._stereo.frames import Frames
from processing._stereo.image_noise import law_of_images
from processing._stereo.method import Method
from processing._stereo.noise_law import NoiseLaw
from processing._stereo.solve import solve_maps
from processing._stereo.stereo_maps import StereoMaps
from rig import no_progress

Float = npt.NDArray[np.float32]

# Red, green, blue.
_CHANNELS = 3
_ROWS = 64


def laws_of_colours(images: ColourImages, method: Method) -> list[Float | None]:
    """Return the law of each channel that images show, see `law_of_images`, if it is needed."""
    if method == "ls" or images.noise is not None:
        return [None] * _CHANNELS
    model = images.model
    return [
        law_of_images(Frames(np.ascontiguousarray(images.values[..., k])), model, images.mask)
        for k in range(_CHANNELS)
    ]


def solve_colours(images: ColourImages, method: Method, laws: Sequence[Float | None]) -> ColourMaps:
    """Solve every channel on its own, and average the normals.

    The weight of a channel at a pixel is the inverse relative variance ``s^2 / variance`` of its
    mean sample s, by the law of the noise under the first light. If the noise is unknown, it is s:
    the variance of shot noise is proportional to the signal. The albedo would be no such measure,
    since a channel that only has noise may have any.

    Parameters
    ----------
    images
        The images.
    method
        Method of `photometric_stereo`.
    laws
        What `laws_of_colours` has returned for these or other rows.
    """
    mask, noise, model = images.mask, images.noise, images.model
    found = ColourMaps.empty(mask.shape, _CHANNELS)
    weights = _weights(images.values, noise)
    residual = np.zeros_like(found.albedo)
    for channel, estimated in enumerate(laws):
        stack = np.ascontiguousarray(images.values[..., channel])
        law: NoiseLaw | Float | None = estimated
        if noise is not None:
            law = NoiseLaw(noise.of_colour(channel), stack.shape)
        maps = StereoMaps.empty(mask.shape)
        solve_maps(
            Frames(stack), model, mask, law, method, maps, images.camera, no_progress, images.rows
        )
        found.normals[:] += maps.normals * weights[..., channel, None]
        found.albedo[..., channel], residual[..., channel] = maps.albedo, maps.residual
        found.used[channel] = maps.used
        found.solved[channel] = maps.albedo.any()
    length = np.linalg.norm(found.normals, axis=2)
    known = length > 0
    np.divide(found.normals, length[..., None], out=found.normals, where=known[..., None])
    found.albedo[~known] = 0
    found.residual[:] = luma(residual)
    return found


def _weights(values: Float, noise: StackNoise | None) -> Float:
    weights: Float = np.zeros(values.shape[1:], np.float32)
    for top in range(0, values.shape[1], _ROWS):
        rows = values[:, top : top + _ROWS]
        measured = np.isfinite(rows)
        signal = np.sum(rows, axis=0, where=measured) / np.maximum(measured.sum(axis=0), 1)
        signal = np.maximum(signal, 0)
        variance = signal if noise is None else noise.variance(0, signal, top)
        np.divide(
            signal**2, variance, out=weights[top : top + _ROWS], where=signal > 0, casting="unsafe"
        )
    return weights
