"""Matching of a tethered camera's images to shots: by order, and by time if one is missing."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median_low
from typing import Final

from rig import pluralize

# Number of intervals from which the pace of a series is measured.
PACE_INTERVALS: Final = 5
# Shorter intervals come from copying the files of a memory card, not from the shots.
_LEAST_PACE_S: Final = 0.5
# Largest deviation of an interval from a whole number of paces in a regular series.
_SLACK: Final = 0.3
_GAP: Final = 1.5
# Number of later files that can show that a file was written late but not taken late.
_LOOK_AHEAD: Final = 3
# Cameras record whole seconds: a shorter pace cannot be measured from them.
_CLOCK_PACE_S: Final = 3.0
# Running numbers have four digits: after a turnover, high numbers come before low ones.
_HIGH, _LOW = 9000, 999


@dataclass(frozen=True)
class Arrival:
    """A complete image file.

    Parameters
    ----------
    name
        Name of the file.
    written_s
        Time at which the file was written, seconds since 1970.
    taken_s
        Time at which the camera took the image, in whole seconds since 1970; None if not assigned.
    """

    name: str
    written_s: float
    taken_s: float | None = None

    @property
    def number(self) -> tuple[str, int] | None:
        """The last number in the name, after the text around it; None without a number."""
        numbers = list(re.finditer(r"\d+", self.name.rpartition(".")[0]))
        if not numbers:
            return None
        last = numbers[-1]
        return f"{self.name[: last.start()]}#{self.name[last.end() :]}", int(last.group())


@dataclass(frozen=True)
class Match:
    """Assignment of files to shots.

    Parameters
    ----------
    shots
        Index of the shot by file name.
    gaps
        One line for each gap that was found.
    unused
        Names of files for which no shot is left.
    """

    shots: dict[str, int]
    gaps: tuple[str, ...]
    unused: tuple[str, ...]


def natural(name: str) -> tuple[object, ...]:
    """Return a key that sorts names in natural order, by the value of their numbers."""
    return tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part.casefold())
        for part in re.split(r"(\d+)", name)
        if part
    )


def in_order(written_s: Mapping[str, float]) -> list[str]:
    """Return names in natural order; a camera's numbers may restart after 9999.

    Parameters
    ----------
    written_s
        Time at which each file was written, by name.
    """
    names = sorted(written_s, key=natural)
    numbers = [last[1] if (last := Arrival(name, 0).number) else 0 for name in names]
    turn = next((i for i, number in enumerate(numbers) if number >= _HIGH), 0)
    if not turn or numbers[turn - 1] > _LOW or written_s[names[turn]] > written_s[names[0]]:
        return names
    return [*names[turn:], *names[:turn]]


@dataclass(frozen=True)
class Pace:
    """Steady pace of a series: seconds between shots, and whether from ``taken_s`` of the files."""

    interval_s: float
    taken: bool

    def between(self, earlier: Arrival, later: Arrival) -> float:
        """Return the seconds from one file to the next."""
        if self.taken and earlier.taken_s is not None and later.taken_s is not None:
            return later.taken_s - earlier.taken_s
        return later.written_s - earlier.written_s


def pace_of(arrivals: Sequence[Arrival], interval_s: float | None = None) -> Pace | None:
    """Return the pace of a series of images.

    The camera's own times are preferred if they are precise enough. The times of the files are
    used unless the camera's times contradict them, as they do if the files were copied later.

    Parameters
    ----------
    arrivals
        Files in order. The first `PACE_INTERVALS` intervals are used; at least three are needed.
    interval_s
        Seconds between shots, if assigned.

    Returns
    -------
    Pace or None
        None if the intervals are too few, too short for a camera, or not whole multiples of one
        another, for instance if the shutter was released by hand.
    """
    first = arrivals[: PACE_INTERVALS + 1]
    taken = [arrival.taken_s for arrival in first if arrival.taken_s is not None]
    written = [arrival.written_s for arrival in first]
    if len(taken) == len(first):
        interval = interval_s or _regular(taken)
        if interval is not None and interval >= _CLOCK_PACE_S:
            return Pace(interval, taken=True)
        span_s = taken[-1] - taken[0] if taken else 0.0
        if abs((written[-1] - written[0] if written else 0.0) - span_s) > _CLOCK_PACE_S:
            return None
    interval = interval_s or _regular(written)
    return None if interval is None else Pace(interval, taken=False)


def _regular(times: Sequence[float]) -> float | None:
    intervals = [later - earlier for earlier, later in pairwise(times)]
    if len(intervals) < 3:
        return None
    rough = median_low(intervals)
    if rough < _LEAST_PACE_S or min(intervals) < 0.5 * rough:
        return None
    # The mean over all intervals hardly depends on the jitter of single ones.
    pace = sum(intervals) / sum(round(interval / rough) for interval in intervals)
    off = [abs(interval / pace - round(interval / pace)) for interval in intervals]
    return pace if max(off) <= _SLACK else None


def match_shots(
    arrivals: Sequence[Arrival],
    count: int,
    assigned: Mapping[str, int],
    pace: Pace | None,
    *,
    gaps: bool = True,
) -> Match:
    """Assign each file to its shot; a shot whose image is missing stays empty.

    Files are in the order of the shots. A file that follows after about k paces leaves k - 1
    shots empty. Without a pace the running numbers in the names decide: ``IMG_4`` after ``IMG_2``
    leaves one shot empty.

    Parameters
    ----------
    arrivals
        Files in order.
    count
        Number of shots.
    assigned
        Index of the shot by name, for files that are already assigned; other files do not get
        these shots.
    pace
        Pace of the series; None if only the names can show a gap.
    gaps
        False if only the order counts.
    """
    shots: dict[str, int] = {}
    seen_gaps: list[str] = []
    unused: list[str] = []
    used_shots = set(assigned.values())
    before: Arrival | None = None
    last = -1
    for place, arrival in enumerate(arrivals):
        later = arrivals[place + 1 : place + 1 + _LOOK_AHEAD]
        steps = 1 if before is None or not gaps else _steps(before, arrival, later, pace)
        index = assigned.get(arrival.name, last + steps)
        if arrival.name not in assigned:
            if index >= count or index in used_shots:
                unused.append(arrival.name)
                continue
            if steps > 1 and before is not None:
                seen_gaps.append(_gap(before, arrival, steps, pace))
        shots[arrival.name] = index
        used_shots.add(index)
        before, last = arrival, index
    return Match(shots, tuple(seen_gaps), tuple(unused))


def ends_with_gap(arrivals: Sequence[Arrival], pace: Pace) -> bool:
    """Return whether the last file follows a gap, which later files may still disprove."""
    return len(arrivals) > 1 and _steps(arrivals[-2], arrivals[-1], (), pace) > 1


def _steps(before: Arrival, arrival: Arrival, later: Sequence[Arrival], pace: Pace | None) -> int:
    """Return the number of shots from one file to another: 1 if no image is missing between.

    A file that was delayed or overwritten has a late time. The files after it then arrive too
    early for a real gap.
    """
    if pace is not None:
        paces = [pace.between(before, other) / pace.interval_s for other in (arrival, *later)]
        if paces[0] <= _GAP:
            return 1
        return max(1, min(round(after) - behind for behind, after in enumerate(paces)))
    one, other = before.number, arrival.number
    if one is None or other is None or one[0] != other[0]:
        return 1
    return max(1, other[1] - one[1])


def _gap(before: Arrival, arrival: Arrival, steps: int, pace: Pace | None) -> str:
    missing = pluralize(steps - 1, "image is", "images are")
    if pace is None:
        return f"{missing} missing by number between {before.name} and {arrival.name}"
    return (
        f"{missing} missing between {before.name} and {arrival.name}: they are "
        f"{pace.between(before, arrival):.1f} s apart, the pace is {pace.interval_s:.1f} s"
    )
