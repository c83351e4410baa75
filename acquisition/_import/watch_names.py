"""Running numbers in the names of a tethered camera's files, and the order that they show."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

# A date with a time of day, also with a fraction of seconds: a clock, not a running number.
_CLOCK: Final = re.compile(
    r"(?<!\d)(?:19|20)\d\d[-_. ]?(?:0[1-9]|1[0-2])[-_. ]?(?:0[1-9]|[12]\d|3[01])"
    r"(?:(?:[-_. T]|at)*(?:[01]\d|2[0-3])[-_.:h]?[0-5]\d[-_.:m]?[0-5]\d(?:[-_.]?\d{3})?)(?!\d)"
)
# Longer numbers are clocks or identifiers.
_MOST_DIGITS: Final = 7
# Running numbers have four digits: after a turnover, high numbers come before low ones.
_HIGH, _LOW, TURNOVER = 9000, 999, 9999


def running_number(name: str) -> tuple[str, int] | None:
    """Return the series of a file and its running number, or None if its name has none.

    The number is the last one in the name, except for clocks: dates with a time of day, and numbers
    of more than seven digits. The series is the text around it, without suffix and clocks.
    """
    stem = _CLOCK.sub("", name.rpartition(".")[0])
    numbers = list(re.finditer(r"\d+", stem))
    if not numbers or len(numbers[-1][0]) > _MOST_DIGITS:
        return None
    last = numbers[-1]
    return f"{stem[: last.start()]}#{stem[last.end() :]}".casefold(), int(last.group())


def numbers_between(earlier: int, later: int) -> int:
    """Return how many shots later a running number is; a camera's numbers restart after 9999."""
    if earlier >= _HIGH and later <= _LOW:
        return later + TURNOVER - earlier
    if later >= _HIGH and earlier <= _LOW:
        return later - TURNOVER - earlier
    return later - earlier


def natural(name: str) -> tuple[object, ...]:
    """Return a key that sorts names in natural order, by the value of their numbers."""
    return tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part.casefold())
        for part in re.split(r"(\d+)", name)
        if part
    )


def in_order(written_s: Mapping[str, float]) -> list[str]:
    """Return names by series, in order of their first file; within a series by number.

    Names with a clock are one series, in natural order. Any other name without a running number is
    a series of its own.

    Parameters
    ----------
    written_s
        Time at which each file was written, by name.
    """
    series: dict[str, list[str]] = {}
    for name in sorted(written_s, key=natural):
        numbered = running_number(name)
        clock = "clock" if _CLOCK.search(name) else name
        series.setdefault(clock if numbered is None else numbered[0], []).append(name)
    runs = [_turned(names, written_s) for names in series.values()]
    runs.sort(key=lambda names: (min(written_s[name] for name in names), natural(names[0])))
    return [name for names in runs for name in names]


def _turned(names: list[str], written_s: Mapping[str, float]) -> list[str]:
    """Return a series with high numbers first if its numbers restarted after 9999."""
    numbers = [number[1] if (number := running_number(name)) else 0 for name in names]
    turn = next((i for i, number in enumerate(numbers) if number >= _HIGH), 0)
    if not turn or numbers[turn - 1] > _LOW or written_s[names[turn]] > written_s[names[0]]:
        return names
    return [*names[turn:], *names[:turn]]


def shots_after(earlier: str, later: str) -> int | None:
    """Return how many shots a file comes after another by number; None in different series."""
    one, two = running_number(earlier), running_number(later)
    if one is None or two is None or one[0] != two[0]:
        return None
    return numbers_between(one[1], two[1])
