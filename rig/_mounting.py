"""The mounting of the camera: how to turn its frames upright."""

from __future__ import annotations

from math import isqrt
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

_Scalar = TypeVar("_Scalar", bound=np.generic)


class Mounting(BaseModel):
    """How to make stored frames upright: mirror them left to right first, then turn them clockwise.

    The upright frame has X right and Y up, like the LED positions and the camera model.

    Parameters
    ----------
    rotation_deg
        Angle by which a frame is turned clockwise: 0, 90, 180 or 270.
    mirror
        Whether the frame is mirrored left to right before that, as for a camera behind a mirror.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    rotation_deg: Literal[0, 90, 180, 270] = 0
    mirror: bool = False

    def upright(self, pixels: npt.NDArray[_Scalar]) -> npt.NDArray[_Scalar]:
        """Return a frame ``(H, W)`` or ``(H, W, 3)`` upright."""
        seen = pixels[:, ::-1] if self.mirror else pixels
        return np.ascontiguousarray(np.rot90(seen, -self.rotation_deg // 90))

    def stored(self, pixels: npt.NDArray[_Scalar]) -> npt.NDArray[_Scalar]:
        """Return an upright image as this camera delivers it; the inverse of `upright`."""
        seen = np.rot90(pixels, self.rotation_deg // 90)
        return np.ascontiguousarray(seen[:, ::-1] if self.mirror else seen)

    def upright_shape(self, shape: tuple[int, ...]) -> tuple[int, ...]:
        """Return the shape that `upright` or `stored` gives a frame of this shape."""
        height, width, *rest = shape
        return (width, height, *rest) if self.rotation_deg in (90, 270) else shape

    def upright_cfa(self, cfa: str, size: tuple[int, int]) -> str:
        """Return the colour filter pattern of the upright frame.

        Parameters
        ----------
        cfa
            Colours of the square block that repeats, row by row from the top left of the frame.
        size
            (H, W) of the frame as stored; it matters whether a side is a multiple of the block.

        Raises
        ------
        ValueError
            If the block is not square.
        """
        return _pattern(self.upright(_mosaic(cfa, size)), cfa)

    def stored_cfa(self, cfa: str, size: tuple[int, int]) -> str:
        """Return the pattern of the frame as stored, given that of its upright image."""
        return _pattern(self.stored(_mosaic(cfa, size)), cfa)


def _mosaic(cfa: str, size: tuple[int, int]) -> npt.NDArray[np.str_]:
    """Return the smallest mosaic whose borders cut the pattern as those of the frame do."""
    side = isqrt(len(cfa))
    if side * side != len(cfa):
        raise ValueError(f"the colour filter pattern {cfa} is not a square block")
    block = np.array(list(cfa)).reshape(side, side)
    more: Any = [(0, length % side) for length in size]
    return np.pad(block, more, mode="wrap")


def _pattern(mosaic: npt.NDArray[np.str_], cfa: str) -> str:
    side = isqrt(len(cfa))
    return "".join(mosaic[:side, :side].ravel())
