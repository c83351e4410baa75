"""Sources without some of their images, named by id, number or range of numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from acquisition._errors import DataError
from acquisition.source.source import Source
from acquisition.values.image_names import SAME_NAME
from acquisition.values.running_numbers import Numbered, numbers_of, turnover
from rig import Notice, check_type, pluralize

_LISTED = 12
_RANGE = re.compile(r"([0-9]{1,9})(?:-([0-9]{1,9}))?")


def exclude(source: Source, images: Sequence[str]) -> Source:
    """Return the source without some images and their lights.

    Parameters
    ----------
    source
        The recording.
    images
        Ids of `Source.light_ids` (``L07``, ``buddha.7``; names of files are accepted too), numbers
        (``7``) or ranges of numbers (``0-5``). The number of an image is the first number in its
        id that differs between all images. A range may contain numbers that no image has, and
        the restart of a counter (``9998-2``).
        If it begins before the first or ends after the last, a notice says what it leaves out:
        the numbers may begin at 1 instead of 0.

    Returns
    -------
    Source
        Recording of the other images, in their order; reference frames stay.

    Raises
    ------
    DataError
        If an entry names no image, or no image is left. The message lists the names.
    TypeError
        If ``images`` is a text instead of a list.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import exclude, read_source, write_png
    >>> for i in range(5):
    ...     write_png(f"card.{i}.png", np.full((4, 5), 700, np.uint16))
    >>> exclude(read_source("."), ["card.0", "3-4"]).light_ids
    ('card.1', 'card.2')
    """
    check_type("source", source, Source, "read_source(path) returns one")
    if isinstance(images, str):
        raise TypeError(
            f'images must be a list of names, not the text {images[:40]!r}: write ["L07"]'
        )
    ids = source.light_ids
    numbers = numbers_of(ids)
    place = partial(_place, numbers)
    by_place = {place(number.value): name for number, name in zip(numbers, ids, strict=False)}
    left_out: set[str] = set()
    notices = []
    for entry in map(str.strip, images):
        # Names come first, since they may look like ranges.
        named, span = _of_name(entry, ids), _range(entry)
        if span is not None and not named:
            low, high = sorted(span, key=place)
            named = {name for at, name in by_place.items() if place(low) <= at <= place(high)}
            if named and not min(by_place) <= place(low) <= place(high) <= max(by_place):
                known = sorted((number.value for number in numbers), key=place)
                text = (
                    f"{low}-{high} leaves out {pluralize(len(named), 'image')}: the images have "
                    f"the numbers {known[0]} to {known[-1]}"
                )
                notices.append(Notice("range-beyond-images", text, str(source.path)))
        if not named:
            raise DataError(
                f"{source.path}: no image is named {entry[:40]!r}: there "
                f"{'is' if len(ids) == 1 else 'are'} {_listing(ids)}"
            )
        left_out |= named
    kept = [i for i, name in enumerate(ids) if name not in left_out]
    if not kept:
        raise DataError(
            f"{source.path}: no image is left: all {pluralize(len(ids), 'image')} are excluded"
        )
    return replace(
        source,
        frames=tuple(
            frame
            for frame in source.frames
            if frame.role != "light" or frame.light_id not in left_out
        ),
        lights=None if source.lights is None else source.lights.take(kept),
        warnings=(*source.warnings, *notices),
    )


def _of_name(entry: str, ids: tuple[str, ...]) -> set[str]:
    """Return the ids that are an entry: exactly, in other letters, or as names of files."""
    found = ({name for name in ids if same(name) == same(entry)} for same in SAME_NAME)
    return next(filter(None, found), set())


def _range(entry: str) -> tuple[int, int] | None:
    """Return the first and the last number that an entry names; None if it is only a name."""
    match = _RANGE.fullmatch(entry)
    if match is None:
        return None
    return int(match[1]), int(match[2] or match[1])


def _place(numbers: Sequence[Numbered], value: int) -> int:
    """Return a number that keeps rising where the counter of the images restarted."""
    more = turnover(numbers)
    return value + more + 1 if more and value < numbers[0].value else value


def _listing(ids: tuple[str, ...]) -> str:
    if len(ids) <= _LISTED:
        return ", ".join(ids)
    return f"{', '.join(ids[: _LISTED - 2])}, ... {ids[-1]} ({pluralize(len(ids), 'image')})"
