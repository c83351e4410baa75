"""Raw frames of a source, also row by row, and their signal less the light that no LED gave."""

from __future__ import annotations

import math
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Self

import cv2
import numpy as np

from acquisition.files.storage import storage_error
from acquisition.pixels.images import Image
from acquisition.pixels.plain_rows import PlainRows
from acquisition.source.source import Frame, Reference, Source
from acquisition.values.transfer_curve import LINEAR
from rig.arrays import Bool, Float32, Intp, UInt8

Index = slice | Intp

# Exposure times that differ by less, relatively, count as equal: cameras read them back rounded.
_SAME_EXPOSURE = 1e-3
_GREY_VALUES = 65536
_ROWS = 32


@dataclass(frozen=True)
class _Kept:
    """Place and type of the samples of a frame in the temporary file."""

    begin: int
    dtype: np.dtype[np.generic]


class RowReader:
    """Reads rows of frames; may be used by several threads.

    The first access to a frame checks the file. The rows of an uncompressed frame of a session are
    then read from its file. Any other file is decoded, and its samples are kept in a temporary file
    without a name until `close`.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from acquisition.source import RowReader
    >>> write_png("card.png", np.arange(20, dtype=np.uint16).reshape(4, 5))
    >>> with RowReader() as reader:
    ...     reader.rows(read_source("card.png").frames[0], 1, 2)
    array([[5, 6, 7, 8, 9]], dtype=uint16)
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._of_frame: dict[Frame, PlainRows | _Kept] = {}
        self._file: BinaryIO | None = None
        self._end = 0

    def check(self, frame: Frame) -> None:
        """Check the file of a frame, and prepare its rows; later calls do nothing.

        Raises
        ------
        DataError
            As `Frame.read`, or if samples are not finite.
        StorageError
            If the temporary file cannot be written.
        """
        self._rows_of(frame)

    def rows(self, frame: Frame, first: int, last: int) -> Image:
        """Return the rows from ``first`` to before ``last`` as stored; raises as `check`."""
        kept = self._rows_of(frame)
        if isinstance(kept, PlainRows):
            return kept.read(first, last)
        size = kept.dtype.itemsize * math.prod(frame.shape[1:])
        with self._lock:
            if self._file is None:
                raise ValueError("the reader is closed")
            self._file.seek(kept.begin + first * size)
            data = self._file.read((last - first) * size)
        rows: Image = np.frombuffer(data, kept.dtype).reshape(last - first, *frame.shape[1:])
        return rows

    def _rows_of(self, frame: Frame) -> PlainRows | _Kept:
        with self._lock:
            known = self._of_frame.get(frame)
        if known is not None:
            return known
        rows = None if frame.check_rows is None else frame.check_rows()
        found = self._keep(frame) if rows is None else rows
        with self._lock:
            return self._of_frame.setdefault(frame, found)

    def _keep(self, frame: Frame) -> _Kept:
        pixels = frame.read_finite()
        with self._lock:
            begin, self._end = self._end, self._end + pixels.nbytes
            try:
                if self._file is None:
                    self._file = tempfile.TemporaryFile(prefix="sgp-")  # noqa: SIM115 - see close
                self._file.seek(begin)
                self._file.write(np.ascontiguousarray(pixels).reshape(-1).view(np.uint8).data)
                self._file.flush()
            except OSError as error:
                folder = Path(tempfile.gettempdir())
                raise storage_error(folder, "keep decoded frames", error) from error
        return _Kept(begin, pixels.dtype)

    def close(self) -> None:
        """Remove the temporary file."""
        with self._lock:
            if self._file is not None:
                self._file.close()
            self._file = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Linearizer:
    """Turns frames of a source into linear signal: 0 is black, 1 is the white level.

    Every sample becomes ``(dn - black) / (white - black)``, and this becomes light by the transfer
    curve of the source, less the mean of the reference frames of the same exposure time, made
    linear in the same way: ambient frames if there are any, else dark frames. If no frame of a
    source with a single bracket has an exposure time, all count as equally long. Sources without a
    white level (float images) keep their scale. The references are read on first use; the object
    may be used by several threads.

    Parameters
    ----------
    source
        The frames, with their black and white level and their transfer curve.
    reader
        Reader of rows; without it, every frame is read as a whole.
    """

    def __init__(self, source: Source, reader: RowReader | None = None) -> None:
        self._source = source
        self._reader = reader
        span = source.white_level - source.black_level
        self._span = np.float32(span if np.isfinite(span) else 1.0)
        self._curve = None if source.transfer == LINEAR else source.transfer
        # Light by grey value; a frame of a source has at most 16 bits.
        self._light = np.zeros(0, np.float32)
        if self._curve is not None and np.isfinite(span):
            grey = np.arange(_GREY_VALUES, dtype=np.float64)
            light = self._curve.light((grey - source.black_level) / span)
            self._light = light.astype(np.float32)
        # Without any exposure time, references count if there is only one bracket.
        self._timeless = len({frame.bracket for frame in source.frames}) == 1 and all(
            frame.exposure_us is None for frame in source.frames
        )
        self._lock = threading.Lock()
        self._offsets: list[tuple[float | None, Float32 | None, float]] = []

    def reference(self, exposure_us: float | None) -> Reference | None:
        """Return the role of the reference frames for an exposure time, None without any."""
        roles: tuple[Reference, ...] = ("ambient", "dark")
        return next((role for role in roles if self._references(role, exposure_us)), None)

    def signal(self, frame: Frame) -> Float32:
        """Read a frame and return its signal, of the frame's shape.

        Raises
        ------
        DataError
            If the frame or a reference frame is damaged or contains values that are not finite; the
            message names the file.
        """
        return self.signal_and_saturation(frame)[0]

    def signal_and_saturation(self, frame: Frame) -> tuple[Float32, Bool]:
        """Return `signal` and the samples at or above the white level; raises as `signal` does."""
        return self.part(frame, self.pixels(frame), (slice(None), slice(None)))

    def bands(self, frame: Frame) -> Iterator[tuple[slice, Float32, Bool]]:
        """Yield `signal_and_saturation` in bands of rows that fit into the cache, with their rows.

        Everything about one band should be done before the next: the signal of a large frame in
        colour takes twelve times as much memory as its pixels.
        """
        pixels = self.pixels(frame)
        for rows in row_bands(len(pixels)):
            yield rows, *self.part(frame, pixels, (rows, slice(None)))

    def reference_level(self, exposure_us: float | None) -> tuple[float, int]:
        """Return the median signal of the references that are subtracted, and their number.

        The level is relative to black; both are 0 if nothing is subtracted.
        """
        role = self.reference(exposure_us)
        if role is None:
            return 0.0, 0
        return self._subtracted(exposure_us)[1], len(self._references(role, exposure_us))

    def dark_signal(self, exposure_us: float | None) -> Float32 | None:
        """Return the mean of the dark frames of an exposure time, as signal; None without any."""
        if exposure_us is None and not self._timeless:
            return None
        if self.reference(exposure_us) == "dark":
            return self._subtracted(exposure_us)[0]
        frames = self._references("dark", exposure_us)
        return self._mean_of(frames) if frames else None

    def part(
        self, frame: Frame, pixels: Image, part: tuple[Index, Index], top: int = 0
    ) -> tuple[Float32, Bool]:
        """Return `signal_and_saturation` of the rows and columns ``part`` of the `pixels`.

        ``top`` is the row of the frame at which the pixels begin.
        """
        samples = pixels[part]
        signal = self._linear(samples)
        offset, _ = self._subtracted(frame.exposure_us)
        if offset is not None:
            signal -= offset[top:][part]
        return signal, samples >= self._source.white_level

    def pixels(self, frame: Frame, rows: slice | None = None) -> Image:
        """Read all or some rows of a frame as they are; raises as `signal` does."""
        if rows is None:
            return frame.read_finite()
        if self._reader is None:
            return frame.read_finite()[rows]
        return self._reader.rows(frame, rows.start, rows.stop)

    def _linear(self, pixels: Image) -> Float32:
        if len(self._light) and pixels.dtype == np.uint8:
            table = self._light[:256]
            samples8: UInt8 = np.ascontiguousarray(pixels, np.uint8)
            return np.asarray(cv2.LUT(samples8, table), np.float32).reshape(pixels.shape)
        if len(self._light) and np.issubdtype(pixels.dtype, np.integer):
            light = np.zeros(pixels.shape, np.float32)
            # In parts, because NumPy copies indices to 64 bits.
            for top in range(0, len(pixels), _ROWS):
                light[top : top + _ROWS] = self._light[pixels[top : top + _ROWS]]
            return light
        samples: Float32 = pixels.astype(np.float32) - np.float32(self._source.black_level)
        samples /= self._span
        return samples if self._curve is None else self._curve.light(samples).astype(np.float32)

    def _references(self, role: Reference, exposure_us: float | None) -> list[Frame]:
        return [
            frame
            for frame in self._source.frames
            if frame.role == role and self._same_exposure(frame.exposure_us, exposure_us)
        ]

    def _same_exposure(self, one_us: float | None, other_us: float | None) -> bool:
        if one_us is None or other_us is None:
            return self._timeless
        return same_exposure(one_us, other_us)

    def _subtracted(self, exposure_us: float | None) -> tuple[Float32 | None, float]:
        """Return the mean of the references of an exposure time, and its median."""
        if exposure_us is None and not self._timeless:
            return None, 0.0
        with self._lock:
            for known_us, offset, level in self._offsets:
                if self._same_exposure(known_us, exposure_us):
                    return offset, level
            role = self.reference(exposure_us)
            frames = [] if role is None else self._references(role, exposure_us)
            offset = self._mean_of(frames) if frames else None
            # Every fifth row shows the level of all.
            level = 0.0 if offset is None else float(np.median(offset[::5]))
            self._offsets.append((exposure_us, offset, level))
            return offset, level

    def _mean_of(self, frames: list[Frame]) -> Float32:
        mean = np.zeros(frames[0].shape, np.float32)
        # In parts, because sums need three times the memory; without a reader, each reads all.
        for rows in [slice(0, len(mean))] if self._reader is None else row_bands(len(mean)):
            total = self._linear(self.pixels(frames[0], rows)).astype(np.float64)
            for frame in frames[1:]:
                total += self._linear(self.pixels(frame, rows))
            mean[rows] = total / len(frames)
        return mean


def row_bands(height: int) -> list[slice]:
    """Return the rows of bands of an image that fit into the cache.

    Examples
    --------
    >>> from acquisition.source import row_bands
    >>> row_bands(40)
    [slice(0, 32, None), slice(32, 40, None)]
    """
    return [slice(top, min(top + _ROWS, height)) for top in range(0, height, _ROWS)]


def same_exposure(one_us: float, other_us: float) -> bool:
    """Return whether two exposure times are equal but for rounding by the camera.

    Examples
    --------
    >>> from acquisition.source import same_exposure
    >>> same_exposure(10_000.0, 10_000.4), same_exposure(10_000.0, 20_000.0)
    (True, False)
    """
    return abs(one_us / other_us - 1) < _SAME_EXPOSURE
