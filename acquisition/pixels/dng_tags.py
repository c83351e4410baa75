"""What a DNG file states about its samples: their form, the colour filter, and black levels.

LibRaw keeps less than this: one black level per colour and the mean of ramps, and filters of 2 x 2
or X-Trans (Adobe's DNG specification 1.7).
"""

from __future__ import annotations

import os
import struct
from collections.abc import Mapping
from math import lcm
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from acquisition.pixels.exif_block import FORMATS, Entry, Form
from rig import UnreadableError
from rig.arrays import Float64, Int64, Str

Tags = Mapping[int, tuple[float, ...]]

_SUBFILE, _COMPRESSION, _PHOTOMETRIC, _SAMPLES, _SUBIFDS, _FORMAT = 254, 259, 262, 277, 330, 339
_BLOCK_SIZE, _BLOCK, _VERSION, _LAYOUT = 33421, 33422, 50706, 50711
_REPEAT, _BLACK, _DELTA_H, _DELTA_V, _WHITE = 50713, 50714, 50715, 50716, 50717
_AREA = 50829
_READ: Final = {
    *(_SUBFILE, _COMPRESSION, _PHOTOMETRIC, _SAMPLES, _SUBIFDS, _FORMAT, _BLOCK_SIZE, _BLOCK),
    *(_VERSION, _LAYOUT, _REPEAT, _BLACK, _DELTA_H, _DELTA_V, _WHITE, _AREA),
}
_RATIONALS: Final = (5, 10)
# Rows or columns of the largest sensors are fewer; directories of DNG files are fewer than 16.
_MOST_VALUES: Final = 1 << 17
_MOST_DIRECTORIES: Final = 16
_CFA, _LINEAR_RAW, _FLOAT = 32803, 34892, 3
_COLOURS: Final = "RGBCMYW"
# Filters of sensors repeat after 2 (Bayer), 4 (Quad Bayer, RGBW), 6 (X-Trans) or 8 samples.
_LARGEST_BLOCK: Final = 8
# Compressions of the specification that LibRaw does not read without Adobe's library.
_CODECS: Final = {8: "Deflate", 32946: "Deflate", 52546: "JPEG XL"}


def read_dng_tags(path: Path) -> Tags:
    """Return the tags of the full image of a DNG file; empty for another file.

    Raises
    ------
    UnreadableError, struct.error, OSError
        If the directories of the file are damaged.
    """
    with path.open("rb") as file:
        head = file.read(8)
        order = {b"II*\0": "<", b"MM\0*": ">"}.get(head[:4])
        if order is None:
            return {}
        form = Form(order, "H", "I")
        ahead = list(struct.unpack(f"{order}I", head[4:]))
        directories: list[Tags] = []
        while ahead and len(directories) < _MOST_DIRECTORIES:
            entries, following = form.directory(file, ahead.pop(0))
            # Another TIFF or RAW file; what its directories hold is left to LibRaw.
            if not directories and all(tag != _VERSION for tag, *_ in entries):
                return {}
            tags = _values(file, form, entries)
            directories.append(tags)
            ahead += map(int, tags.get(_SUBIFDS, ()))
            if following:
                ahead.append(following)
    return next(
        (
            tags
            for kind in (_CFA, _LINEAR_RAW)
            for tags in directories
            if tags.get(_PHOTOMETRIC) == (kind,) and tags.get(_SUBFILE, (0,)) == (0,)
        ),
        {},
    )


def check_dng(tags: Tags) -> None:
    """Refuse samples that LibRaw does not read, or does not read as they are.

    Raises
    ------
    UnreadableError
        If they are floating-point numbers, compressed with another codec, staggered or demosaiced.
    """
    if tags.get(_FORMAT, (1,))[0] == _FLOAT:
        raise UnreadableError(
            "this DNG holds floating-point samples, which are not read: convert it to a DNG of "
            "whole numbers, or to float TIFF"
        )
    codec = _CODECS.get(int(tags.get(_COMPRESSION, (1,))[0]))
    if codec is not None:
        raise UnreadableError(
            f"this DNG is compressed with {codec}, which is not read: convert it to a DNG with "
            "lossless JPEG or without compression"
        )
    if tags.get(_LAYOUT, (1,)) != (1,):
        raise UnreadableError(
            "the colour filter in this DNG is not rectangular (CFALayout), which is not read: "
            "convert the camera's own RAW file to 16-bit TIFF"
        )
    samples = int(tags.get(_SAMPLES, (1,))[0])
    if samples > 1 and tags[_PHOTOMETRIC] == (_LINEAR_RAW,):
        raise UnreadableError(
            f"this DNG holds {samples} values per pixel and no mosaic, because it was demosaiced: "
            "use the camera's own RAW file, or convert it to 16-bit TIFF"
        )


def filter_block(tags: Tags, top: int, left: int) -> Str | None:
    """Return the letters of the colour filter at a row and column of the file.

    Returns
    -------
    numpy.ndarray or None
        ``(K, K)``, the block that repeats; None if the file does not state it.

    Raises
    ------
    UnreadableError
        If the tags contradict each other.
    """
    if _BLOCK not in tags or _BLOCK_SIZE not in tags:
        return None
    codes = np.array(tags[_BLOCK], np.int64)
    rows, columns = _size(tags[_BLOCK_SIZE], len(codes), "CFAPattern")
    if codes.min() < 0 or codes.max() >= len(_COLOURS):
        raise UnreadableError("the colour filter in the file is damaged: copy the file again")
    side = lcm(rows, columns)
    if side > _LARGEST_BLOCK:
        raise UnreadableError(
            f"a colour filter that repeats after {rows} rows and {columns} columns is not read"
        )
    y, x = _places(tags, top, left, (side, side))
    letters = np.array(list(_COLOURS))[codes.reshape(rows, columns)]
    return letters[y % rows][:, x % columns]


def black_levels(
    tags: Tags, top: int, left: int, shape: tuple[int, ...], side: int
) -> Float64 | None:
    """Return the black levels of samples from a row and column of the file on.

    Returns
    -------
    numpy.ndarray or None
        ``(side, side)`` if they repeat so, else of the given shape; DN. None if the file states
        none.

    Raises
    ------
    UnreadableError
        If the tags contradict each other or the size of the image.
    """
    if not {_BLACK, _DELTA_H, _DELTA_V} & set(tags):
        return None
    table = np.array(tags.get(_BLACK, (0.0,)), np.float64)
    size = _size(tags.get(_REPEAT, (1, 1)), len(table), "BlackLevel")
    table = table.reshape(size)
    ramps = _DELTA_V in tags or _DELTA_H in tags
    if not ramps and side % size[0] == side % size[1] == 0:
        shape = (side, side)
    y, x = _places(tags, top, left, shape)
    levels = table[y % size[0]][:, x % size[1]]
    for tag, name, places in ((_DELTA_V, "V", y), (_DELTA_H, "H", x)):
        if tag in tags:
            ramp = np.array(tags[tag], np.float64)
            if places.min() < 0 or places.max() >= len(ramp):
                raise UnreadableError(
                    f"BlackLevelDelta{name} has {len(ramp)} values, which are too few for the "
                    "active area: copy the file again"
                )
            levels = levels + (ramp[places][:, None] if tag == _DELTA_V else ramp[places])
    if not np.isfinite(levels).all():
        raise UnreadableError("the black levels in the file are damaged: copy the file again")
    block = levels[:side, :side]
    repeats = all(
        (levels[y::side, x::side] == block[y, x]).all() for y, x in np.ndindex(*block.shape)
    )
    return block if repeats else levels


def white_levels(tags: Tags, top: int, left: int, letters: Str) -> Float64 | None:
    """Return the white levels of the block of a colour filter; None if the file states only one.

    Parameters
    ----------
    tags
        Tags of the full image.
    top, left
        Row and column of the file at which the block begins.
    letters
        ``(K, K)``, the colours of the block.

    Returns
    -------
    numpy.ndarray or None
        ``(K, K)``, DN. Three levels are those of red, green and blue; as many as the block has
        positions are theirs; of another number, the lowest holds for all.
    """
    stated = np.array(tags.get(_WHITE, ()), np.float64)
    if len(stated) < 2:
        return None
    if len(stated) == 3 and set(letters.ravel()) <= set("RGB"):
        return stated[np.vectorize("RGB".index)(letters)]
    if len(stated) == letters.size:
        y, x = _places(tags, top, left, letters.shape)
        return stated.reshape(letters.shape)[y % len(letters)][:, x % len(letters)]
    return np.full(letters.shape, stated.min())


def _places(tags: Tags, top: int, left: int, shape: tuple[int, ...]) -> tuple[Int64, Int64]:
    """Return rows and columns in the active area, from which blocks and ramps count."""
    area = [int(value) for value in tags.get(_AREA, (0, 0, 0, 0))]
    if len(area) != 4:
        raise UnreadableError("ActiveArea in the file is damaged: copy the file again")
    return top - area[0] + np.arange(shape[0]), left - area[1] + np.arange(shape[1])


def _size(size: tuple[float, ...], count: int, name: str) -> tuple[int, int]:
    rows, columns = (int(value) for value in (*size, 0, 0)[:2])
    if rows < 1 or columns < 1 or rows * columns != count:
        raise UnreadableError(
            f"{name} has {count} values, not {rows} x {columns}: the file is damaged, copy it again"
        )
    return rows, columns


def _values(file: BinaryIO, form: Form, entries: list[Entry]) -> Tags:
    """Return the values of the known tags of a directory."""
    end = file.seek(0, os.SEEK_END)
    tags: dict[int, tuple[float, ...]] = {}
    for tag, kind, count, field in entries:
        if tag not in _READ or kind not in FORMATS or not count:
            continue
        codes = f"{form.order}{FORMATS[kind] * min(count, _MOST_VALUES)}"
        size = struct.calcsize(codes)
        if count > _MOST_VALUES or size > end:
            raise UnreadableError(f"tag {tag} is damaged: copy the file again")
        numbers = struct.unpack(codes, form.values(file, field, size, size))
        if kind in _RATIONALS:
            numbers = tuple(
                one / other if other else float("nan")
                for one, other in zip(numbers[::2], numbers[1::2], strict=True)
            )
        tags[tag] = numbers
    return tags
