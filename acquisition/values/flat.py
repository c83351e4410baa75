"""The relative response of lens and sensor at each pixel."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from acquisition._errors import DataError
from acquisition.values.setup import Calibrated
from rig.arrays import Float32

# A response below this share of the middle amplifies noise and stray light without limit.
_LEAST, _MOST = 0.01, 100.0


@dataclass(frozen=True, eq=False)
class Flat:
    """A flat field: by how much lens and sensor change the light that reaches each pixel.

    Linear signal divided by `response` is what a lens without vignetting and a sensor with equal
    pixels would show.

    Parameters
    ----------
    smooth
        ``(H, W)``, or ``(H, W, 3)`` for frames in colour, float32: vignetting, 1 in the middle of
        the image. Each site of a mosaic has the value of its own colour.
    pixel
        Float32 of the same shape: response of the pixels (PRNU, dust) relative to their
        surroundings, mean 1.
    cfa
        Colour filters of the first 2 x 2 pixels, row by row; None for frames without a mosaic.
    pixel_std
        Standard deviation of `pixel` by temporal noise; None if it is not known.
    gradient_std
        Standard deviation of a linear gradient of `smooth`, as the relative change from the middle
        to a corner; None if it is not known. It is common to all images.
    covered
        Share of the pixels that were measured. Elsewhere, `smooth` is extrapolated and `pixel` is
        1.
    calibrated
        When, and with which camera and lens, it was measured.

    Raises
    ------
    DataError
        If the shapes differ, or a value is not finite or outside 0.01 to 100.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Flat
    >>> flat = Flat(np.full((2, 3), 0.8, np.float32), np.full((2, 3), 1.01, np.float32))
    >>> flat.response[0, 0].round(3)
    np.float32(0.808)
    """

    smooth: Float32
    pixel: Float32
    cfa: str | None = None
    pixel_std: float | None = None
    gradient_std: float | None = None
    covered: float = 1.0
    calibrated: Calibrated = field(default_factory=Calibrated)

    def __post_init__(self) -> None:
        for name in ("smooth", "pixel"):
            values = np.asarray(getattr(self, name), np.float32)
            object.__setattr__(self, name, values)
            colours = values.ndim == 3 and values.shape[2] == 3
            if not (values.ndim == 2 or colours) or values.size == 0:
                raise DataError(
                    f"the {name} part of a flat has the shape {values.shape}: (H, W) or (H, W, 3) "
                    "is required"
                )
            usable = (values >= _LEAST) & (values <= _MOST)
            if not usable.all():
                row, column = np.argwhere(~usable)[0][:2]
                raise DataError(
                    f"the {name} part of a flat is {values[row, column]} at pixel {column},{row}: "
                    f"numbers within {_LEAST:g} to {_MOST:g} are required; calibrate it again"
                )
        if self.smooth.shape != self.pixel.shape:
            raise DataError(
                f"the parts of a flat have the shapes {self.smooth.shape} and {self.pixel.shape}: "
                "they must be equal"
            )

    def __repr__(self) -> str:
        height, width = self.smooth.shape[:2]
        corner = float(self.smooth[[0, 0, -1, -1], [0, -1, 0, -1]].mean())
        mosaic = "" if self.cfa is None else f", {self.cfa}"
        return f"Flat({width} x {height} px, corners {corner:.1%}{mosaic})"

    @property
    def response(self) -> Float32:
        """Product of both parts, by which linear signal is divided."""
        return self.smooth * self.pixel
