"""Images that are decoded for a search in all of them, and not again when they are used."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

from acquisition._pixels.images import Image
from acquisition._pixels.plain_rows import PlainRows
from acquisition._source.source import Frame
from rig import memory_budget

# Decoding a PNG takes as long as a fifth of `sgp normals`. Kept are 50 images of 5 megapixels with
# 16 bits, and never more than an eighth of the memory for a computation, which follows.
_MOST_BYTES: Final = 1 << 29
_SHARE: Final = 8

_Version = tuple[int, int] | None


class DecodedOnce:
    """Reads frames, and keeps the pixels until they are read again, as far as there is room."""

    def __init__(self) -> None:
        self._pixels: dict[Frame, tuple[Image, _Version]] = {}
        self._room = min(_MOST_BYTES, memory_budget() // _SHARE)

    def read(self, frame: Frame) -> Image:
        """Return the pixels, which must not be changed; raises as `Frame.read`."""
        if frame in self._pixels:
            return self._pixels[frame][0]
        version = _version(frame)
        pixels = frame.read()
        if pixels.nbytes <= self._room:
            self._room -= pixels.nbytes
            self._pixels[frame] = pixels, version
        return pixels

    def frame(self, frame: Frame) -> Frame:
        """Return the frame, whose first reading returns the pixels that are kept."""
        if frame not in self._pixels:
            return frame
        rows = frame.check_rows
        return replace(
            frame,
            load=partial(self._taken, frame),
            check_rows=None if rows is None else partial(self._rows, frame),
        )

    def _taken(self, frame: Frame) -> Image:
        pixels, version = self._pixels.pop(frame, (None, None))
        if pixels is None or version != _version(frame):
            return frame.read_stored()
        return pixels

    def _rows(self, frame: Frame) -> PlainRows | None:
        self._pixels.pop(frame, None)
        return None if frame.check_rows is None else frame.check_rows()


def _version(frame: Frame) -> _Version:
    """Return size and time of a file, by which a later change is noticed; None if it is missing."""
    try:
        stat = frame.path.stat()
    except OSError:
        return None
    return stat.st_size, stat.st_mtime_ns
