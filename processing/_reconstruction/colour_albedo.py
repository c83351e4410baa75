"""Albedo in colour, from a second pass over the images under known lights and normals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from acquisition import Lights, Source
from calibration import linear_images, luma
from processing._stereo.frames import Frames
from processing._stereo.light_model import LightModel
from processing._stereo.photometric_stereo import PhotometricStereoResult
from rig import Progress

Float = npt.NDArray[np.float32]

_BLOCK = 65536
# Residuals of noiseless images are rounding errors of about this size, relative to the albedo.
_ROUNDING = np.float32(1e-5)


def colour_albedo(
    source: Source,
    ids: Sequence[str],
    lights: Lights,
    stereo: PhotometricStereoResult,
    points_mm: npt.NDArray[np.float64] | None,
    on_progress: Progress,
) -> Float:
    """Return the albedo of each colour, or the gray albedo of a source without colour.

    The colour of a pixel is ``a * sum(w v) / sum(w g)`` over its images: a is the gray albedo, v
    the sample in colour, g its gray value, and ``w = max(l . n, 0) / (1 + (r / s)^2)`` with the
    residual ``r = g - a l . n`` and its root mean square s. If all w were ``l . n``, this would be
    the least-squares albedo of each colour under the known normals (Woodham, 1980); the other
    factors leave out shadows and highlights. The gray value of the result is the gray albedo.

    Parameters
    ----------
    source
        The recording. If its first image has three equal channels, it is without colour.
    ids
        Ids of the images that were used.
    lights
        Their lights.
    stereo
        Result of photometric stereo on the gray images.
    points_mm
        ``(H, W, 3)`` surface points for lights with positions, else None.
    on_progress
        Receives the stage ``colour``, one step per image.

    Returns
    -------
    Float
        ``(H, W, 3)`` float32 RGB in the unit of `stereo.albedo`, or ``(H, W)``; 0 outside its mask.
    """
    if source.cfa is None and len(source.frames[0].shape) == 2:
        return stereo.albedo
    mask = stereo.normal_map.mask
    pixels = np.flatnonzero(mask)
    normals = stereo.normal_map.normals.reshape(-1, 3)
    albedo = stereo.albedo.reshape(-1)
    rms = stereo.residual.reshape(-1)
    sums = np.zeros((len(pixels), 3), np.float32)
    total = np.zeros(len(pixels), np.float32)
    for i, image in enumerate(linear_images(source, ids, channel="rgb")):
        if i == 0 and (image == image[..., :1]).all(where=np.isfinite(image)):
            return stereo.albedo
        gray = Frames(luma(image)[None])
        model = LightModel(lights.take([i]), points_mm, mask)
        for first in range(0, len(pixels), _BLOCK):
            part = slice(first, first + _BLOCK)
            block = pixels[part]
            values, vectors = model.samples(gray, block)
            lit = np.maximum(np.einsum("pc,pc->p", normals[block], vectors[..., 0]), 0)
            seen = values[:, 0]
            spread = np.maximum(rms[block], albedo[block] * _ROUNDING)
            # Radiance may be as large as a float can be; such pixels stay gray.
            with np.errstate(over="ignore", invalid="ignore"):
                residual = (seen - albedo[block] * lit) / spread
                weight = lit / (1 + residual * residual) / np.float32(len(ids))
            known = np.isfinite(weight)
            weight[~known] = 0
            colour = image.reshape(-1, 3)[block]
            colour[~known] = 0
            sums[part] += weight[:, None] * colour
            total[part] += weight * np.where(known, seen, 0)
        on_progress("colour", i + 1, len(ids))
    # A pixel without a usable sample stays gray.
    usable = total > 0
    gray_albedo = albedo[pixels]
    with np.errstate(over="ignore", invalid="ignore"):
        ratio = np.divide(gray_albedo, total, out=np.zeros_like(total), where=usable)
        np.maximum(sums, 0, out=sums)
        sums *= ratio[:, None]
    sums[~usable] = gray_albedo[~usable, None]
    result = np.zeros((*mask.shape, 3), np.float32)
    result[mask] = sums
    return result
