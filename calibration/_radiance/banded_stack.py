"""The stack of a source in bands of rows, for recordings that do not fit into memory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Self

import numpy as np

from acquisition import RowReader, Source
from calibration._radiance.developer import Developer
from calibration._radiance.linear_stack import Stack
from calibration._radiance.stack_tasks import (
    Channel,
    FloatImage,
    brightest_sample,
    check_usable,
    frames_of_lights,
    lit_frames,
)
from rig import Notice, Progress, check_type, no_progress

_THREADS = 4
# Samples of the frames that are decoded at the same time, usually of 2 bytes.
_DECODED = 250_000_000
# Bytes of the values of a band, if the caller does not choose its rows.
_BAND = 64_000_000
# Rows of an image that are made at once. An even number keeps the colours of a mosaic in place.
_ROWS_AT_ONCE = 512


class BandedStack:
    """The stack of a source, of which only the rows in use are in memory; see `open_stack`.

    It has the attributes ids, lights, mask, camera, hot_pixels and pattern of `Stack`, and
    ``shape``: N, H, W, and 3 for images in colour.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import open_stack
    >>> for i in range(3):
    ...     write_png(f"card.{i}.png", np.full((6, 5), 20_000 * (i + 1), np.uint16))
    >>> with open_stack(read_source(".")) as stack:
    ...     means = [band.values.mean(axis=(1, 2)).round(2) for _, band in stack.bands(4)]
    >>> means[0], means[1]
    (array([0.31, 0.61, 0.92], dtype=float32), array([0.31, 0.61, 0.92], dtype=float32))
    """

    def __init__(
        self,
        source: Source,
        *,
        channel: Channel = "gray",
        on_progress: Progress = no_progress,
        reader: RowReader | None = None,
    ) -> None:
        self._source = source
        self._reader = RowReader() if reader is None else reader
        try:
            lit = lit_frames(source)
            self._develop = Developer(source, lit, channel, self._reader)
            self._tasks = frames_of_lights(source, lit)
            of_lights = [frames for frames, _ in self._tasks]
            threads = max(1, _DECODED // math.prod(source.frames[0].shape))
            with ThreadPoolExecutor(min(threads, _THREADS)) as pool:
                checked = pool.map(lambda frames: [*map(self._reader.check, frames)], of_lights)
                for done, _ in enumerate(checked, start=1):
                    on_progress("reading", done, len(of_lights))
            first = self._develop(*self._tasks[0], rows=slice(0, 1))
        except BaseException:
            self._reader.close()
            raise
        shape = (len(source.light_ids), source.size[0], *first.shape[1:])
        # The complete stack but for its values, which take no memory.
        self._form = Stack(
            np.broadcast_to(np.float32(0), shape),
            source.light_ids,
            source.lights,
            source.mask,
            source.camera,
            noise=self._develop.noise(self._tasks, None),
            hot_pixels=self._develop.hot_pixels,
            pattern=self._develop.pattern,
        )
        self.shape: tuple[int, ...] = shape
        self.ids = self._form.ids
        self.lights = self._form.lights
        self.mask = self._form.mask
        self.camera = self._form.camera
        self.hot_pixels = self._form.hot_pixels
        self.pattern = self._form.pattern

    def __repr__(self) -> str:
        return f"BandedStack({list(self.shape)})"

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """As in `Stack`; brackets are compared in the rows that were made so far."""
        return self._develop.notices

    def rows(self, first: int, last: int) -> Stack:
        """Return the stack of the rows from ``first`` to before ``last``.

        It is equal to these rows of `linear_stack`; see `Stack.rows`.

        Raises
        ------
        ValueError
            If there are no such rows.
        DataError
            If a file was changed, or can no longer be read.
        """
        part = self._form.rows(first, last)
        rows = slice(first, last)
        used = self._develop.used(self._tasks, rows)
        values = np.zeros(part.values.shape, np.float32)

        def fill(i: int) -> None:
            of_one = None if used is None else used[i]
            self._develop(*self._tasks[i], rows=rows, out=values[i], used=of_one)

        with ThreadPoolExecutor(_THREADS) as pool:
            for _ in pool.map(fill, range(len(values))):
                pass
        noise = None if part.noise is None else replace(part.noise, used=used)
        return replace(part, values=values, noise=noise, warnings=self.warnings)

    def in_channel(self, channel: Channel) -> BandedStack:
        """Return the same images in another channel, without reading or keeping frames again.

        It is closed with this one.
        """
        return BandedStack(self._source, channel=channel, reader=self._reader)

    def image(self, index: int, rows: slice | None = None) -> FloatImage:
        """Return the image of one light, ``(H, W)`` or ``(H, W, 3)``, as in `linear_stack`.

        ``rows``, with start and stop, limits it to these rows.

        Raises
        ------
        DataError
            As `rows`.
        """
        wanted = slice(0, self.shape[1]) if rows is None else rows
        image = np.zeros((wanted.stop - wanted.start, *self.shape[2:]), np.float32)
        # In parts, because the frames and what is computed of them need far more memory.
        for first in range(wanted.start, wanted.stop, _ROWS_AT_ONCE):
            part = slice(first, min(first + _ROWS_AT_ONCE, wanted.stop))
            inside = slice(part.start - wanted.start, part.stop - wanted.start)
            self._develop(*self._tasks[index], rows=part, out=image[inside])
        return image

    def bands(self, rows: int | None = None) -> Iterator[tuple[slice, Stack]]:
        """Yield all rows in bands, from the top, with their stacks.

        Parameters
        ----------
        rows
            Rows of a band; default: as many as need 64 MB. The last band may have fewer.

        Raises
        ------
        ValueError
            If ``rows`` is not at least 1.
        DataError
            As `rows`.
        EstimateError
            After the last band, if all samples of all images are saturated or black.
        """
        height = self.shape[1]
        of_one = 4 * int(np.prod(self.shape)) // height
        step = max(1, _BAND // of_one) if rows is None else rows
        if step < 1:
            raise ValueError(f"a band has at least 1 row, not {rows}")
        brightest = []
        for first in range(0, height, step):
            last = min(first + step, height)
            band = self.rows(first, last)
            brightest.append(brightest_sample(band.values))
            yield slice(first, last), band
        check_usable(brightest, self.ids, self._source, self._develop.reference_level)

    def close(self) -> None:
        """Remove the decoded frames from the disk."""
        self._reader.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_stack(
    source: Source,
    *,
    channel: Channel = "gray",
    on_progress: Progress = no_progress,
) -> BandedStack:
    """Check the frames of a source and return its stack, whose values are made on request.

    Use it instead of `linear_stack` for recordings that do not fit into memory. In memory are the
    rows in use, the mask, and one image for each exposure time with dark or ambient frames.
    Uncompressed frames of sessions are read from their files. Others are decoded once, and kept in
    a temporary file until `BandedStack.close`.

    Parameters
    ----------
    source, channel
        As in `linear_stack`, as are the errors.
    on_progress
        Receives the stage ``reading``, one step per light, while the frames are checked.

    Returns
    -------
    BandedStack
        To be closed, for example by ``with``.

    Raises
    ------
    StorageError
        If the temporary file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import open_stack
    >>> for i in range(2):
    ...     write_png(f"card.{i}.png", np.full((400, 5), 65535 // (i + 2), np.uint16))
    >>> with open_stack(read_source(".")) as stack:
    ...     stack, stack.rows(100, 102).values[:, 0, :2].round(3)
    (BandedStack([2, 400, 5]), array([[0.5  , 0.5  ],
           [0.333, 0.333]], dtype=float32))
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    return BandedStack(source, channel=channel, on_progress=on_progress)
