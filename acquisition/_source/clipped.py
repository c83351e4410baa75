"""Sources whose samples were clipped below the white level that their files state."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from math import isfinite, isnan, isqrt

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._pixels.images import Image
from acquisition._pixels.pile_up import PileUp, find_pile_up, planes_of
from acquisition._source.source import Frame, Source
from acquisition._values.transfer_curve import LINEAR
from rig import Notice, pluralize

_LOW_BITS = {2**bits - 1: bits for bits in (10, 12, 14)}


def with_clipped(source: Source) -> Source:
    """Set the white level to the value at which samples were clipped, with a notice.

    If colours were clipped at different values, or samples follow a transfer curve, which refers to
    the white level, it remains, and clipped samples are raised to it as they are read.
    """
    side = 1 if source.cfa is None else isqrt(len(source.cfa))
    images = [partial(_read, frame) for frame in source.frames if frame.role == "light"]
    pile = find_pile_up(images, side, source.white_level)
    if pile is None:
        return source
    level = max(value for value in pile.levels if not isnan(value))
    one = pile.brightest <= level and len({v for v in pile.levels if not isnan(v)}) == 1
    notice = _notice(source, pile, level if one else None)
    warnings = (*source.warnings, notice)
    if one and source.transfer == LINEAR:
        return replace(source, white_level=level, warnings=warnings)
    white = source.white_level if isfinite(source.white_level) else max(level, pile.brightest)
    mark = partial(_marked, side, pile.levels, white)
    # Rows that are read one by one would be read as stored.
    frames = [replace(frame, mark_clipped=mark, check_rows=None) for frame in source.frames]
    return replace(source, white_level=white, frames=tuple(frames), warnings=warnings)


def _read(frame: Frame) -> Image | None:
    try:
        return frame.read()
    except (DataError, MissingPathError, StorageError):
        return None  # the error is reported where the image is used


def _notice(source: Source, pile: PileUp, level: float | None) -> Notice:
    where, samples = str(source.path), pluralize(pile.samples, "sample is", "samples are")
    if level is None:
        letters = source.cfa or "RGB"
        values = [
            f"{letter} at {value:g}"
            for letter, value in zip(letters, pile.levels, strict=True)
            if not isnan(value)
        ]
        listed = ", ".join(dict.fromkeys(values))
        text = f"{samples} clipped, {listed}: they count as saturated"
        return Notice("clipped-below-white", text, where, "info")
    bits = _LOW_BITS.get(int(level)) if source.white_level == 65535 else None
    if bits is not None:
        text = (
            f"{bits}-bit samples in the low bits of 16: many are saturated at {level:.0f}, which "
            "is taken as the white level"
        )
        return Notice("samples-in-low-bits", text, where, "info")
    stated = f" instead of {source.white_level:g}" if isfinite(source.white_level) else ""
    text = f"{samples} clipped at {level:g}, which is taken as the white level{stated}"
    return Notice("clipped-below-white", text, where, "info")


def _marked(side: int, levels: tuple[float, ...], white: float, pixels: Image) -> Image:
    marked = pixels.copy()
    for plane, level in zip(planes_of(marked, side), levels, strict=True):
        if not isnan(level):
            plane[plane >= level] = white
    return marked
