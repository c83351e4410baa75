"""Matching of a tethered camera's images to shots: by number, by order, or by a stated interval."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from acquisition._errors import DataError
from acquisition.values.running_numbers import running_number, shots_after
from rig import Notice, pluralize

_GAP: Final = 1.5
# Number of later files that can show that a file was written late but not taken late.
_LOOK_AHEAD: Final = 3
# Cameras record whole seconds: a shorter interval cannot be measured from them.
_CLOCK_INTERVAL_S: Final = 3.0


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


@dataclass(frozen=True)
class Rule:
    """What counts as a gap between two images.

    Parameters
    ----------
    gaps
        False if nothing does: images are counted in order of arrival.
    interval_s
        Seconds between shots if times show gaps; None if only the numbers in the names do.
    """

    gaps: bool = True
    interval_s: float | None = None


@dataclass
class Match:
    """Assignment of new files to shots.

    Parameters
    ----------
    shots
        Index of the shot by file name.
    by_order
        Files that got the next shot because neither number nor time gave one.
    notices
        By file name, what is remarkable about the assignment, such as a gap.
    unused
        Files that get no shot, each with the reason.
    """

    shots: dict[str, int] = field(default_factory=dict)
    by_order: set[str] = field(default_factory=set)
    notices: dict[str, list[Notice]] = field(default_factory=dict)
    unused: list[Notice] = field(default_factory=list)


def match_shots(
    arrivals: Sequence[Arrival],
    labels: Sequence[str],
    recorded: Mapping[str, int],
    rule: Rule = Rule(),
    *,
    named: Mapping[str, int] | None = None,
    waiting: Collection[str] = (),
    earlier: Collection[str] = (),
) -> Match:
    """Assign each new file to its shot; a shot whose image is missing stays empty.

    Parameters
    ----------
    arrivals
        Complete files in order, new and recorded ones.
    labels
        Name of each shot.
    recorded
        Index of the shot by name, of files that were recorded, in order of recording.
    rule
        What counts as a gap.
    named
        The same for files named after their shots. No other file is counted from them.
    waiting
        Files that are not complete yet.
    earlier
        Files of an earlier watch: the time between them and new files has no meaning.

    Raises
    ------
    DataError
        If a number shows that the first recorded image was not the first shot.
    """
    matching = _Matching(arrivals, labels, rule, waiting, earlier, dict(recorded))
    matching.taken = {index: name for name, index in {**(named or {}), **recorded}.items()}
    for at, arrival in enumerate(arrivals):
        if arrival.name not in recorded:
            matching.place(at)
    return matching.match


def follows_gap(arrivals: Sequence[Arrival], interval_s: float) -> bool:
    """Return whether the last file follows a gap in time, which later files may still disprove."""
    return len(arrivals) > 1 and (_steps(arrivals[-2], arrivals[-1], (), interval_s) or 1) > 1


@dataclass
class _Matching:
    """A matching in progress; parameters as in `match_shots`."""

    arrivals: Sequence[Arrival]
    labels: Sequence[str]
    rule: Rule
    waiting: Collection[str]
    earlier: Collection[str]
    placed: dict[str, int]
    taken: dict[int, str] = field(default_factory=dict)
    match: Match = field(default_factory=Match)

    def place(self, at: int) -> None:
        """Assign a new file to its shot, or give the reason for which it gets none."""
        name, count = self.arrivals[at].name, len(self.labels)
        before = self._counted_from(name)
        steps = 1 if before is None else self._steps(before, at)
        index = self._first(name) if before is None else self.placed[before] + steps
        if before is not None and abs(steps) >= max(count, 2):
            index = self._restarted(name, before, steps)
            before = None
        elif before is None and self.placed:
            index = self._next(name)
        if index < 0:
            raise DataError(
                f"{name}: its number is below that of {before}, which was recorded as "
                f"{self.labels[self.placed[str(before)]]}: the lights of this session are shifted. "
                "Import the folder again into a new session, or move the file out of the folder if "
                "it is not part of the recording"
            )
        if index in self.taken:
            text = f"not recorded: its shot {self.labels[index]} already has {self.taken[index]}"
            self.match.unused.append(Notice("image-without-shot", text, name))
        elif index >= count:
            text = "no shot is left for this image"
            text += "" if before is None else f", counted from {before}"
            self.match.unused.append(Notice("image-without-shot", text, name))
        else:
            if before is not None:
                self._note_gap(before, at, steps)
            self.placed[name] = self.match.shots[name] = index
            self.taken[index] = name

    def _counted_from(self, name: str) -> str | None:
        """Return the placed file from which a file is counted; None to take the next shot."""
        if not self.rule.gaps:
            return None
        numbered = {other: shots_after(other, name) for other in self.placed}
        below = {other: n for other, n in numbered.items() if n is not None and n >= 0}
        above = {other: n for other, n in numbered.items() if n is not None and n < 0}
        if below:
            # 9999 and 0000 may both seem to come just before 0001: the later one does.
            return min(below, key=lambda other: (below[other], -self.placed[other]))
        if above:
            return max(above, key=above.__getitem__)
        timed = self.rule.interval_s is not None and running_number(name) is None
        return max(self.placed, key=self.placed.__getitem__, default=None) if timed else None

    def _steps(self, before: str, at: int) -> int:
        """Return the number of shots from a placed file to a new one."""
        name = self.arrivals[at].name
        far = shots_after(before, name)
        arrival = self._arrival(before)
        by_order = 1 if far is None else far
        if self.rule.interval_s is None or arrival is None or by_order < 1:
            return by_order
        later = self.arrivals[at + 1 : at + 1 + _LOOK_AHEAD]
        steps = _steps(arrival, self.arrivals[at], later, self.rule.interval_s)
        if steps is None:
            return by_order
        if before not in self.earlier:
            return steps
        if steps > by_order:
            text = f"the time since {before} does not count, because the watch was restarted"
            self._note(name, text)
        return by_order

    def _arrival(self, name: str) -> Arrival | None:
        return next((arrival for arrival in self.arrivals if arrival.name == name), None)

    def _first(self, name: str) -> int:
        """Return the shot of the first image: 0, unless an image before it is incomplete."""
        before = [n for other in self.waiting if (n := shots_after(other, name)) is not None]
        steps = max((n for n in before if 0 < n < len(self.labels)), default=0)
        return steps if self.rule.gaps else 0

    def _next(self, name: str) -> int:
        """Return the shot after the last one for a file that continues no series."""
        last = max(self.placed, key=self.placed.__getitem__)
        index = self.placed[last] + 1
        while self.taken.get(index, last) not in self.placed:  # a file named after its shot
            index += 1
        self.match.by_order.add(name)
        run = sum(shots_after(last, other) is not None for other in self.placed)
        if self.rule.gaps and run > 1:
            self._note(name, f"does not continue the numbers of {last}: it gets the next shot")
        elif not self.rule.gaps and (shots_after(last, name) or 0) < 0:
            self._note(name, f"has a lower number than {last}: it gets the next shot")
        return index

    def _restarted(self, name: str, before: str, steps: int) -> int:
        """Return the next shot for a file that is too far away for a gap."""
        by = "numbers" if steps == shots_after(before, name) else "intervals"
        text = f"is {abs(steps)} {by} away from {before}, more than there are shots"
        self._note(name, f"{text}: it gets the next shot")
        self.match.by_order.add(name)
        return max(self.placed.values()) + 1

    def _note(self, name: str, text: str) -> None:
        self.match.notices.setdefault(name, []).append(Notice("image-next-shot", text, name))

    def _note_gap(self, before: str, at: int, steps: int) -> None:
        """Report shots that stay empty before a file, unless their files are only incomplete."""
        arrival, interval_s = self.arrivals[at], self.rule.interval_s
        far = shots_after(before, arrival.name)
        first = self.placed[before] + 1
        empty = sum(index not in self.taken for index in range(first, first + steps - 1))
        text = f"missing by number between {before} and {arrival.name}"
        if steps == far:
            arriving = [shots_after(other, arrival.name) or 0 for other in self.waiting]
            empty -= sum(0 < n < steps for n in arriving)
        elif interval_s is not None and (earlier := self._arrival(before)) is not None:
            apart_s = _seconds(earlier, arrival, interval_s) or 0.0
            if steps == 1 and far is not None:
                empty, text = far - 1, f"{text}, but not by time"
            else:
                text = (
                    f"missing between {before} and {arrival.name}: they are {apart_s:.1f} s apart, "
                    f"the interval is {interval_s:.1f} s"
                )
        if empty > 0:
            text = f"{pluralize(empty, 'image is', 'images are')} {text}"
            self.match.notices.setdefault(arrival.name, []).append(Notice("images-missing", text))


def _seconds(before: Arrival, arrival: Arrival, interval_s: float) -> float | None:
    """Return the seconds from one file to another; None if their times contradict each other.

    The camera's own times are preferred if they are precise enough. The times of the files are used
    unless the camera's times contradict them, as they do if the files were copied later.
    """
    written_s = arrival.written_s - before.written_s
    if before.taken_s is None or arrival.taken_s is None:
        return written_s
    taken_s = arrival.taken_s - before.taken_s
    if interval_s >= _CLOCK_INTERVAL_S:
        return taken_s
    return written_s if abs(written_s - taken_s) <= _CLOCK_INTERVAL_S else None


def _steps(
    before: Arrival, arrival: Arrival, later: Sequence[Arrival], interval_s: float
) -> int | None:
    """Return the number of shots from one file to another by time; None if the times show none.

    A file that was delayed or overwritten has a late time. The files after it then arrive too
    early for a real gap.
    """
    first_s = _seconds(before, arrival, interval_s)
    if first_s is None:
        return None
    if first_s / interval_s <= _GAP:
        return 1
    times = [_seconds(before, other, interval_s) for other in (arrival, *later)]
    after = [round(time_s / interval_s) for time_s in times if time_s is not None]
    return max(1, min(steps - behind for behind, steps in enumerate(after)))
