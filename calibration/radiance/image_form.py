"""From the radiance at the pixels of the frames to the values of an image."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from acquisition import DataError, Frame, Source
from acquisition.source import Reduction
from calibration.radiance.demosaicing import check_pattern, demosaic, luma, site_factors
from rig.arrays import Float32, Float64

# What the images of a stack show: gray values, colours, or the colour of each site of a mosaic.
Channel = Literal["gray", "rgb", "mosaic"]

_SITES = ((0, 0), (0, 1), (1, 0), (1, 1))


class ImageForm:
    """Channel, region and resolution of the images of a source.

    Parameters
    ----------
    source
        The frames; its mosaic and its reduction count.
    channel
        As in `linear_stack`.
    """

    def __init__(self, source: Source, channel: Channel) -> None:
        self._source = source
        self._channel = channel

    @property
    def demosaiced(self) -> bool:
        """Whether the pixels of images are interpolated between sites of a mosaic."""
        return self._source.cfa is not None and self._channel != "mosaic"

    @property
    def independent(self) -> bool:
        """Whether every pixel of an image is from one pixel of the frames."""
        return not self.demosaiced and self._source.reduction is None

    @property
    def pattern(self) -> str | None:
        """Colours of the first 2 x 2 pixels of the images of a mosaic, row by row."""
        cfa, reduction = self._source.cfa, self._source.reduction
        if cfa is None or self._channel != "mosaic":
            return None
        y, x = (0, 0) if reduction is None else (reduction.y % 2, reduction.x % 2)
        return "".join(cfa[2 * ((row + y) % 2) + (column + x) % 2] for row, column in _SITES)

    def window(self, rows: slice) -> tuple[slice, Reduction | None]:
        """Return the rows of the frames that rows of an image need, and the image's part of them.

        Demosaicing needs neighbours, and begins at the first site of the mosaic. The part is None
        if it is everything.
        """
        height, width = self._source.frames[0].shape[:2]
        whole = self._source.reduction or Reduction(0, 0, width, height)
        first, last = (whole.y + row * whole.factor for row in (rows.start, rows.stop))
        top, bottom = first, last
        if self.demosaiced:
            top, bottom = max(first - 1, 0) // 2 * 2, min(last + 1, height)
        if self._source.reduction is None and (top, bottom) == (first, last):
            return rows, None
        return slice(top, bottom), replace(whole, y=first - top, height=last - first)

    def image(
        self,
        radiance: Float32,
        intensity: Float64,
        frame: Frame,
        top: int,
        cut: Reduction | None = None,
    ) -> Float32:
        """Return an image from radiance that begins at row ``top`` of the frames.

        Raises
        ------
        DataError
            If the frame does not have the colours of the channel, or an unknown mosaic.
        """
        if self._channel == "mosaic":
            return self._sites(radiance, intensity, frame, top, cut)
        if radiance.ndim == 2 and self._source.cfa is not None:
            radiance = demosaic(radiance, self._source.cfa)
        if cut is not None:
            radiance = cut.mean(radiance)
        if radiance.ndim == 2:
            if self._channel == "rgb":
                raise DataError(f"{frame.path}: the image has one channel: use gray")
            return divided(radiance, intensity)
        radiance /= intensity.astype(np.float32)
        return radiance if self._channel == "rgb" else luma(radiance)

    def _sites(
        self, image: Float32, intensity: Float64, frame: Frame, top: int, cut: Reduction | None
    ) -> Float32:
        """Divide every site of a mosaic by the intensity in its colour."""
        cfa = self._source.cfa
        if cfa is None or image.ndim != 2:
            raise DataError(f"{frame.path}: the image has no colour mosaic: use gray")
        check_pattern(cfa)
        if cut is not None and cut.factor > 1:
            raise DataError(
                f"{frame.path}: averages of pixels have no single colour filter: use gray, or the "
                "full resolution"
            )
        for row, column in _SITES:
            colour = cfa[2 * ((row + top) % 2) + column]
            image[row::2, column::2] /= np.float32(intensity["RGB".index(colour)])
        return image if cut is None else cut.cut(image).copy()

    def colour(self, frame: Frame) -> bool:
        """Return whether images of one channel are the luma of colours."""
        return len(frame.shape) == 3 or (self._source.cfa is not None and self.pattern is None)

    def site_factor(self) -> Float64:
        """Return `StackNoise.site_factor`: how interpolation and averages change the variance."""
        reduction = self._source.reduction
        step, at = (
            (1, (0, 0)) if reduction is None else (reduction.factor, (reduction.y, reduction.x))
        )
        if self._source.cfa is None or self.pattern is not None:
            return np.full((1, 1, 3), 1 / step**2)
        return site_factors(self._source.cfa, at, step)

    def response(self) -> Float32 | None:
        """Return by what the flat divided the signal at each pixel of the images.

        Interpolated and averaged pixels have the mean of those from which they were made.
        """
        if self._source.flat is None:
            return None
        response, reduction = self._source.flat.response, self._source.reduction
        if self.demosaiced and self._source.cfa is not None:
            response = demosaic(response, self._source.cfa)
        return response if reduction is None else reduction.mean(response)


def divided(image: Float32, intensity: Float64) -> Float32:
    """Divide an image of one channel by the mean intensity of its light, in place."""
    strength = np.float32(intensity.mean())
    if strength != 1:
        image /= strength
    return image
