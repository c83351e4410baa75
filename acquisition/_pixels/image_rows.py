"""Rows of an image file, decoded as they are used."""

from __future__ import annotations

import math
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from acquisition._errors import convert_read_errors
from acquisition._pixels.opened_image import check_png_file, opened_image
from rig import MAX_PIXELS, convert_parser_errors


class ImageRows:
    """An image as `read_image` returns it, of which only the rows in use are in memory.

    Read from the top downwards: a compressed file is decoded again from its start otherwise.

    Parameters
    ----------
    path
        As in `read_image`, as are the errors; damage shows when its rows are read.
    max_pixels
        Largest allowed number of pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import ImageRows, write_png
    >>> write_png("ramp.png", np.arange(20, dtype=np.uint16).reshape(5, 4))
    >>> with ImageRows("ramp.png") as rows:
    ...     rows.shape, rows[1:3]
    ((5, 4), array([[ 4,  5,  6,  7],
           [ 8,  9, 10, 11]], dtype=uint16))
    """

    def __init__(self, path: str | Path, *, max_pixels: int = MAX_PIXELS) -> None:
        self.path = Path(path)
        with ExitStack() as opened:
            self._image = opened.enter_context(opened_image(self.path, max_pixels))
            check_png_file(self.path)
            self._opened = opened.pop_all()
        spec = self._image.spec
        size = (spec.height, spec.width)
        self._alpha = spec.alpha_channel
        self.shape: tuple[int, ...] = size if len(self._image.channels) == 1 else (*size, 3)
        self.dtype = np.dtype(self._image.dtype)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, rows: slice) -> npt.NDArray[Any]:
        return self._image.colours(self._read(rows))

    def with_alpha(self, rows: slice) -> tuple[npt.NDArray[Any], npt.NDArray[Any] | None]:
        """Return rows as `read_image_with_alpha` does: the colours, and alpha or None."""
        band = self._read(rows)
        if self._alpha < 0:
            return self._image.colours(band), None
        return self._image.colours(band), np.ascontiguousarray(band[..., self._alpha])

    def _read(self, rows: slice) -> npt.NDArray[Any]:
        """Return rows ``(h, W, channels)`` of all channels of the file."""
        first, last, _ = rows.indices(self.shape[0])
        file, spec = self._image.file, self._image.spec
        with (
            convert_read_errors(self.path),
            convert_parser_errors("cut short or damaged, copy it again"),
        ):
            top = spec.y + first
            band = file.read_scanlines(
                top, spec.y + last, 0, 0, spec.nchannels, spec.format.basetype
            )
            message = file.geterror()
        if band is None or message:
            raise self._image.undecodable(self.path, message)
        # Doubles beyond the range of float32 become infinite, as in `read_image`.
        with np.errstate(over="ignore"):
            pixels: npt.NDArray[Any] = band.reshape(last - first, self.shape[1], spec.nchannels)
            return pixels.astype(self.dtype, copy=False)

    @property
    def size(self) -> int:
        """Number of values."""
        return math.prod(self.shape)

    def close(self) -> None:
        """Close the file; harmless if repeated."""
        self._opened.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
