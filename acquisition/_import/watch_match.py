"""Which shot each image of a tethered camera is of: by order, and by time where one is missing."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median_low
from typing import Final

# Intervals from which the pace of a series is taken; with fewer nothing is said about gaps.
PACE_INTERVALS: Final = 5
# Copying a card's files is faster than any rig: such times are not those of the shots.
_LEAST_PACE_S: Final = 0.5
# How far an interval may lie from a whole number of paces for a series to count as regular.
_SLACK: Final = 0.3
_GAP: Final = 1.5
# How many later files may show that one was not taken late but only written late.
_LOOK_AHEAD: Final = 3
# Cameras note whole seconds: a pace below this cannot be told from them.
_CLOCK_PACE_S: Final = 3.0
# Running numbers have four digits: those near the end come before those near the beginning.
_HIGH, _LOW = 9000, 999


@dataclass(frozen=True)
class Arrival:
    """A file that is there and whole.

    Parameters
    ----------
    name
        Of the file.
    written_s
        When it was written, seconds since 1970.
    taken_s
        When the camera says it was taken, in whole seconds; None where it does not.
    """

    name: str
    written_s: float
    taken_s: float | None = None

    @property
    def number(self) -> tuple[str, int] | None:
        """The last number in the name with what stands around it, for counting files."""
        found = list(re.finditer(r"\d+", self.name.rpartition(".")[0]))
        if not found:
            return None
        last = found[-1]
        return f"{self.name[: last.start()]}#{self.name[last.end() :]}", int(last.group())


@dataclass(frozen=True)
class Match:
    """What became of the arrivals.

    Parameters
    ----------
    shots
        Index of the shot by file name.
    gaps
        One line for each gap that was seen.
    unused
        Names that no shot is left for.
    """

    shots: dict[str, int]
    gaps: tuple[str, ...]
    unused: tuple[str, ...]


def natural(name: str) -> tuple[object, ...]:
    """Return a key that sorts names as people count."""
    return tuple(
        (0, int(part), "") if part.isdecimal() else (1, 0, part.casefold())
        for part in re.split(r"(\d+)", name)
        if part
    )


def in_order(written_s: Mapping[str, float]) -> list[str]:
    """Return names as people count, and as cameras do: after 9999 they begin anew.

    Parameters
    ----------
    written_s
        When each file was written, by name.
    """
    names = sorted(written_s, key=natural)
    numbers = [found[1] if (found := Arrival(name, 0).number) else 0 for name in names]
    turn = next((i for i, number in enumerate(numbers) if number >= _HIGH), 0)
    if not turn or numbers[turn - 1] > _LOW or written_s[names[turn]] > written_s[names[0]]:
        return names
    return [*names[turn:], *names[:turn]]


@dataclass(frozen=True)
class Pace:
    """The steady pace of a series: seconds between shots, and which of the two times tells it."""

    interval_s: float
    taken: bool

    def between(self, earlier: Arrival, later: Arrival) -> float:
        """Return the seconds from one file to the next."""
        if self.taken and earlier.taken_s is not None and later.taken_s is not None:
            return later.taken_s - earlier.taken_s
        return later.written_s - earlier.written_s


def pace_of(arrivals: Sequence[Arrival], interval_s: float | None = None) -> Pace | None:
    """Return the pace of a series of images.

    The camera's own times are preferred, where they are fine enough. Times of files count if the
    camera's do not contradict them, as they do where files were copied later.

    Parameters
    ----------
    arrivals
        In order. The first `PACE_INTERVALS` intervals count, at least three.
    interval_s
        Seconds between shots, where known.

    Returns
    -------
    Pace or None
        None where the intervals are too few, too short for a camera, or not whole multiples of one
        another, as when a person presses the button.
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
    # Over all of them the unevenness of single intervals hardly counts.
    pace = sum(intervals) / sum(round(interval / rough) for interval in intervals)
    off = [abs(interval / pace - round(interval / pace)) for interval in intervals]
    return pace if max(off) <= _SLACK else None


def match_shots(
    arrivals: Sequence[Arrival],
    count: int,
    known: Mapping[str, int],
    pace: Pace | None,
    *,
    gaps: bool = True,
) -> Match:
    """Give each file its shot, leaving a hole where one is missing.

    Files come in the order of the shots. One that comes after about k paces leaves k - 1 holes;
    without a pace the running numbers in the names tell: ``IMG_4`` after ``IMG_2`` leaves one.

    Parameters
    ----------
    arrivals
        In order.
    count
        Number of shots.
    known
        Shots of files that have theirs already; other files do not get these.
    pace
        None where only the names can tell.
    gaps
        False where order alone counts.
    """
    shots: dict[str, int] = {}
    told: list[str] = []
    unused: list[str] = []
    given = set(known.values())
    before: Arrival | None = None
    last = -1
    for place, arrival in enumerate(arrivals):
        later = arrivals[place + 1 : place + 1 + _LOOK_AHEAD]
        steps = 1 if before is None or not gaps else _steps(before, arrival, later, pace)
        index = known.get(arrival.name, last + steps)
        if arrival.name not in known:
            if index >= count or index in given:
                unused.append(arrival.name)
                continue
            if steps > 1 and before is not None:
                told.append(_gap(before, arrival, steps, pace))
        shots[arrival.name] = index
        given.add(index)
        before, last = arrival, index
    return Match(shots, tuple(told), tuple(unused))


def ends_with_gap(arrivals: Sequence[Arrival], pace: Pace) -> bool:
    """Tell whether a gap lies before the last file that later files may yet show to be none."""
    return len(arrivals) > 1 and _steps(arrivals[-2], arrivals[-1], (), pace) > 1


def _steps(before: Arrival, arrival: Arrival, later: Sequence[Arrival], pace: Pace | None) -> int:
    """Return how many shots a file lies after another: 1 where none is missing between.

    A file that was held up on its way, or written anew, has a late time. Those after it then come
    too early for the gap before it to be one.
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
    missing = "1 image is" if steps == 2 else f"{steps - 1} images are"
    if pace is None:
        return f"{missing} missing by number between {before.name} and {arrival.name}"
    return (
        f"{missing} missing between {before.name} and {arrival.name}, taken "
        f"{pace.between(before, arrival):.1f} s apart where {pace.interval_s:.1f} s is the pace"
    )
