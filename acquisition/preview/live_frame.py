"""A live frame, upright, with the figures that an operator adjusts the rig by."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np

from acquisition.pixels.frame_quality import FrameQuality
from acquisition.pixels.quality import measure_quality
from rig import Rig, Shot
from rig.arrays import Bool, Float64, Int64, UInt16
from rig.messages import short_repr

BINS: Final = 64


@dataclass(frozen=True)
class Region:
    """A rectangle of the upright frame, pixels: columns from ``left``, rows from ``top``."""

    left: int
    top: int
    width: int
    height: int

    def within(self, size: tuple[int, int]) -> Region:
        """Return the part that lies in a frame of this (H, W), at least one pixel."""
        left = min(max(0, self.left), size[1] - 1)
        top = min(max(0, self.top), size[0] - 1)
        right = min(max(left + 1, self.left + self.width), size[1])
        bottom = min(max(top + 1, self.top + self.height), size[0])
        return Region(left, top, right - left, bottom - top)

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns."""
        rows = slice(self.top, self.top + self.height)
        return rows, slice(self.left, self.left + self.width)


@dataclass(frozen=True, eq=False)
class LiveFrame:
    """A frame for the operator.

    Parameters
    ----------
    number
        Running number of the frame.
    leds
        The LEDs that lit it: one, several for a composite, none if all were off.
    pixels
        ``(H, W)`` uint16, upright, raw values.
    clipped
        ``(H, W)`` bool: samples at the white level, in any frame of a composite.
    black_dn, white_dn
        Grey values without light and of saturation.
    cfa
        Colour filter pattern of the upright frame; None for monochrome.
    exposure_us, gain_db
        As the camera reported them.
    """

    number: int
    leds: tuple[int, ...]
    pixels: UInt16
    clipped: Bool
    black_dn: float
    white_dn: float
    cfa: str | None
    exposure_us: float
    gain_db: float

    __repr__ = short_repr

    @classmethod
    def of(cls, number: int, shot: Shot, rig: Rig, black_dn: float = 0.0) -> Self:
        """Return the frame of a shot, turned upright as the rig file states.

        Parameters
        ----------
        number
            Running number.
        shot
            A shot of the rig.
        rig
            The rig.
        black_dn
            Grey value without light.
        """
        frame, info, mounting = shot.frame, rig.camera.info, rig.config.mounting
        size = (info.height, info.width)
        pixels = mounting.upright(frame.pixels)
        return cls(
            number,
            () if shot.led is None else (shot.led,),
            pixels,
            pixels >= info.white_dn,
            black_dn,
            float(info.white_dn),
            None if info.cfa is None else mounting.upright_cfa(info.cfa, size),
            frame.exposure_us,
            frame.gain_db,
        )

    @property
    def size(self) -> tuple[int, int]:
        """(H, W) of the frame."""
        height, width = self.pixels.shape
        return height, width

    @property
    def clipped_fraction(self) -> float:
        """Share of saturated samples of the complete frame."""
        return float(np.count_nonzero(self.clipped)) / self.clipped.size

    @cached_property
    def histogram(self) -> Int64:
        """Number of samples in each of `BINS` equal ranges from 0 to the white level."""
        scale = BINS / (self.white_dn + 1)
        bins = np.arange(65536) * scale
        counts = np.bincount(self.pixels.ravel(), minlength=65536)
        ranks = np.minimum(bins, BINS - 1).astype(np.intp)
        return np.bincount(ranks, counts, BINS).astype(np.int64)

    def quality(self, region: Region | None = None) -> FrameQuality:
        """Return the figures of a region, by default of the complete frame.

        Its sharpness serves for focusing as long as light, exposure and region stay the same.
        """
        part = self.pixels if region is None else self.pixels[region.within(self.size).slices]
        return measure_quality(part, white_level_dn=self.white_dn, black_level_dn=self.black_dn)


class Composite:
    """The mean of the frames of several LEDs, as if all were on: the board lights one at a time."""

    def __init__(self) -> None:
        self._sum: Float64 | None = None
        self._clipped: Bool | None = None
        self._leds: list[int] = []

    def add(self, frame: LiveFrame) -> None:
        """Add the frame of one LED."""
        if self._sum is None or self._clipped is None:
            self._sum, self._clipped = np.zeros(frame.size), np.zeros(frame.size, bool)
        self._sum += frame.pixels
        self._clipped |= frame.clipped
        self._leds += frame.leds

    def frame(self, last: LiveFrame) -> LiveFrame:
        """Return the composite of the frames added so far, with the values of the last one.

        Raises
        ------
        ValueError
            If no frame was added.
        """
        if self._sum is None or self._clipped is None:
            raise ValueError("no frame was added")
        return LiveFrame(
            last.number,
            tuple(self._leds),
            np.rint(self._sum / len(self._leds)).astype(np.uint16),
            self._clipped,
            last.black_dn,
            last.white_dn,
            last.cfa,
            last.exposure_us,
            last.gain_db,
        )
