"""Sources without some of their images, named by id, number or range of numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from acquisition._errors import DataError
from acquisition._source.source import Source
from acquisition._values.lights import light_id
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
        id that differs between all images. A range may contain numbers that no image has.
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
    numbers = _numbers(ids)
    left_out: set[str] = set()
    notices = []
    for entry in map(str.strip, images):
        # Names come first, since they may look like ranges.
        named, span = _of_name(entry, ids), _range(entry)
        if span is not None and not named:
            named = {name for number, name in numbers.items() if span[0] <= number <= span[1]}
            if named and not min(numbers) <= span[0] <= span[1] <= max(numbers):
                notices.append(_beyond(source, span, len(named), numbers))
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
    for same in (str, str.casefold, light_id):
        found = {name for name in ids if same(name) == same(entry)}
        if found:
            return found
    return set()


def _range(entry: str) -> tuple[int, int] | None:
    """Return the first and the last number that an entry names; None if it is only a name."""
    match = _RANGE.fullmatch(entry)
    if match is None:
        return None
    first, last = sorted((int(match[1]), int(match[2] or match[1])))
    return first, last


def _beyond(source: Source, span: tuple[int, int], named: int, numbers: dict[int, str]) -> Notice:
    """Return the notice about a range that the numbers of the images do not cover."""
    text = (
        f"{span[0]}-{span[1]} leaves out {pluralize(named, 'image')}: the images have the numbers "
        f"{min(numbers)} to {max(numbers)}"
    )
    return Notice("range-beyond-images", text, str(source.path))


def _numbers(ids: tuple[str, ...]) -> dict[int, str]:
    """Return the ids by the first of their numbers that differs between all; empty without one."""
    runs = [[int(run) for run in re.findall(r"[0-9]{1,18}", name)] for name in ids]
    for place in range(min(map(len, runs), default=0)):
        by_number = {run[place]: name for run, name in zip(runs, ids, strict=True)}
        if len(by_number) == len(ids):
            return by_number
    return {}


def _listing(ids: tuple[str, ...]) -> str:
    if len(ids) <= _LISTED:
        return ", ".join(ids)
    return f"{', '.join(ids[: _LISTED - 2])}, ... {ids[-1]} ({pluralize(len(ids), 'image')})"
