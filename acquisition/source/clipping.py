"""Sources whose samples were clipped below the white level that their files state."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import inf, isfinite, isnan, isqrt
from typing import Final

import numpy as np

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition.pixels.images import Image
from acquisition.pixels.pile_up import PileUp, find_pile_up, planes_of
from acquisition.pixels.plain_rows import PlainRows
from acquisition.source.source import Frame, Source
from acquisition.values.transfer_curve import LINEAR
from rig import Notice, pluralize
from rig.processes import memory_budget

# Floats of another range are no scaled samples of a sensor.
_LEAST_WHITE = 255
_LOW_BITS = {2**bits - 1: bits for bits in (10, 12, 14)}
# Decoding a PNG takes as long as a fifth of `sgp normals`. Kept are 50 images of 5 megapixels with
# 16 bits, and never more than an eighth of the memory for a computation, which follows.
_MOST_BYTES: Final = 1 << 29
_SHARE: Final = 8

_Version = tuple[int, int] | None


def with_clipped(source: Source) -> Source:
    """Set the white level to the value at which samples were clipped, with a notice.

    If colours were clipped at different values, or samples follow a transfer curve, which refers to
    the white level, it remains, and clipped samples are raised to it as they are read.
    """
    side = 1 if source.cfa is None else isqrt(len(source.cfa))
    lights = [frame for frame in source.frames if frame.role == "light"]
    # Files with other levels are scaled to those of the first: equal samples differ by fractions.
    scaled: set[Frame] = set()
    decoded = DecodedOnce()
    images = [partial(_read, decoded, frame, source.white_level, scaled) for frame in lights]
    pile = find_pile_up(images, side, source.white_level)
    source = replace(source, frames=tuple(map(decoded.frame, source.frames)))
    if pile is not None and scaled:
        pile = pile._replace(levels=tuple(value - 0.5 for value in pile.levels))
    level = 0.0 if pile is None else max(value for value in pile.levels if not isnan(value))
    if pile is None or level <= source.black_level:
        return source
    found = {value for value in pile.levels if not isnan(value)}
    if len(found) == 1 and pile.brightest <= level and source.transfer == LINEAR:
        warnings = (*source.warnings, _white_notice(source, pile, level))
        return replace(source, white_level=level, warnings=warnings)
    white = source.white_level if isfinite(source.white_level) else max(level, pile.brightest)
    mark = partial(_marked, side, pile.levels, white)
    # Rows that are read one by one would be read as stored.
    frames = [replace(frame, mark_clipped=mark, check_rows=None) for frame in source.frames]
    warnings = (*source.warnings, _marked_notice(source, pile))
    return replace(source, white_level=white, frames=tuple(frames), warnings=warnings)


def _read(decoded: DecodedOnce, frame: Frame, white: float, scaled: set[Frame]) -> Image | None:
    """Return the pixels, None if they cannot be read; scaled ones are rounded and noted."""
    try:
        pixels = decoded.read(frame)
    except (DataError, MissingPathError, StorageError):
        return None  # the error is reported where the image is used
    if pixels.dtype.kind != "f" or not _LEAST_WHITE <= white < inf:
        return pixels
    scaled.add(frame)
    return np.clip(np.rint(pixels), 0, np.iinfo(np.uint16).max).astype(np.uint16)


def _white_notice(source: Source, pile: PileUp, level: float) -> Notice:
    bits = _LOW_BITS.get(int(level)) if source.white_level == 65535 else None
    if bits is not None:
        text = (
            f"{bits}-bit samples in the low bits of 16: many are saturated at {level:.0f}, which "
            "is taken as the white level"
        )
        return Notice("samples-in-low-bits", text, str(source.path), "info")
    stated = f" instead of {source.white_level:g}" if isfinite(source.white_level) else ""
    text = f"{_clipped(pile)} at {level:g}, which is taken as the white level{stated}"
    return Notice("clipped-below-white", text, str(source.path), "info")


def _marked_notice(source: Source, pile: PileUp) -> Notice:
    letters = (source.cfa or "RGB") if len(pile.levels) > 1 else [""]
    values = [
        f"{value:g} ({letter})" if letter else f"{value:g}"
        for letter, value in zip(letters, pile.levels, strict=False)
        if not isnan(value)
    ]
    text = f"{_clipped(pile)} at {', '.join(dict.fromkeys(values))}: they count as saturated"
    return Notice("clipped-below-white", text, str(source.path), "info")


def _clipped(pile: PileUp) -> str:
    return f"{pluralize(pile.samples, 'sample is', 'samples are')} clipped"


def _marked(side: int, levels: tuple[float, ...], white: float, pixels: Image) -> Image:
    marked = pixels.copy()
    for plane, level in zip(planes_of(marked, side), levels, strict=True):
        if not isnan(level):
            plane[plane >= level] = white
    return marked


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
