"""Albedo in colour, from a second pass over the images under known lights and normals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acquisition import Lights, Source
from calibration.radiance import linear_images, luma
from processing.images.viewing_rays import SurfacePoints
from processing.maps.normal_map import NormalMap
from processing.stereo.frames import Frames
from processing.stereo.light_model import LightModel
from rig import Progress
from rig.arrays import Float32, Float64

_BLOCK = 65536
# Residuals of noiseless images are rounding errors of about this size, relative to the albedo.
_ROUNDING = np.float32(1e-5)


def colour_albedo(
    source: Source,
    ids: Sequence[str],
    lights: Lights,
    normals: NormalMap,
    albedo: Float32,
    residual: Float32,
    points: SurfacePoints | None,
    on_progress: Progress,
) -> Float32 | None:
    """Return the albedo of each colour; None for a source without colour.

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
    normals, albedo, residual
        Normals, gray albedo and residual of the gray images.
    points
        Surface points for lights with positions, else None.
    on_progress
        Receives the stage ``colour``, one step per image.

    Returns
    -------
    Float or None
        ``(H, W, 3)`` float32 RGB in the unit of the gray albedo; 0 outside the mask of the normals.
    """
    if not may_have_colour(source):
        return None
    points_mm = None if points is None else points.of()
    sums = ColourSums(normals, albedo, residual, points_mm)
    for i, image in enumerate(linear_images(source, ids, channel="rgb")):
        if i == 0 and not coloured(image):
            return None
        sums.add(image, lights.take([i]), len(ids))
        on_progress("colour", i + 1, len(ids))
    return sums.albedo()


def may_have_colour(source: Source) -> bool:
    """Return whether the frames of a source have colours, which may all be equal."""
    return source.cfa is not None or len(source.frames[0].shape) == 3


def coloured(image: Float32) -> bool:
    """Return whether the channels of an image, or of rows of it, differ."""
    return not (image == image[..., :1]).all(where=np.isfinite(image))


class ColourSums:
    """Sums over images from which the albedo of each colour follows, of all rows or some.

    Parameters
    ----------
    normal_map
        Normals of the rows.
    albedo, residual
        Gray albedo, and root mean square of the residuals, ``(H, W)``.
    points_mm
        Surface points ``(H, W, 3)`` for lights with positions.
    """

    def __init__(
        self,
        normal_map: NormalMap,
        albedo: Float32,
        residual: Float32,
        points_mm: Float64 | None,
    ) -> None:
        self._mask, self._points_mm = normal_map.mask, points_mm
        self._pixels = np.flatnonzero(normal_map.mask)
        self._normals = normal_map.normals.reshape(-1, 3)
        self._albedo, self._rms = albedo.reshape(-1), residual.reshape(-1)
        self._sums = np.zeros((len(self._pixels), 3), np.float32)
        self._total = np.zeros(len(self._pixels), np.float32)

    def add(self, image: Float32, light: Lights, count: int) -> None:
        """Add an image ``(H, W, 3)``, with its light, of ``count`` in all."""
        gray = Frames(luma(image)[None])
        model = LightModel(light, self._points_mm, self._mask)
        for first in range(0, len(self._pixels), _BLOCK):
            part = slice(first, first + _BLOCK)
            block = self._pixels[part]
            values, vectors = model.samples(gray, block)
            lit = np.maximum(np.einsum("pc,pc->p", self._normals[block], vectors[..., 0]), 0)
            seen = values[:, 0]
            spread = np.maximum(self._rms[block], self._albedo[block] * _ROUNDING)
            # Radiance may be as large as a float can be; such pixels stay gray.
            with np.errstate(over="ignore", invalid="ignore"):
                residual = (seen - self._albedo[block] * lit) / spread
                weight = lit / (1 + residual * residual) / np.float32(count)
            known = np.isfinite(weight)
            weight[~known] = 0
            colour = image.reshape(-1, 3)[block]
            colour[~known] = 0
            self._sums[part] += weight[:, None] * colour
            self._total[part] += weight * np.where(known, seen, 0)

    def albedo(self) -> Float32:
        """Return the albedo ``(H, W, 3)`` after all images; a pixel without samples stays gray."""
        sums, total = self._sums, self._total
        usable = total > 0
        gray_albedo = self._albedo[self._pixels]
        with np.errstate(over="ignore", invalid="ignore"):
            ratio = np.divide(gray_albedo, total, out=np.zeros_like(total), where=usable)
            np.maximum(sums, 0, out=sums)
            sums *= ratio[:, None]
        sums[~usable] = gray_albedo[~usable, None]
        result = np.zeros((*self._mask.shape, 3), np.float32)
        result[self._mask] = sums
        return result
