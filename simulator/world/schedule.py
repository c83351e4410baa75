"""What happens in a world: a seed for its choices, and a list of faults."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from acquisition import DataError

VERSION = 3
# The steps of a recording among which the faults are spread.
_STEPS = 1300
_FAULTS = (3, 12)
# Share of the faults that recur when a program has just been started again and recovers what is
# there; the steps that this takes; the programs among which they are spread.
_RECUR, _RECOVERY_STEPS, _MOST_AFTER = 0.4, 400, 2
MOST = 300
_AT_FLUSH = 0.5


@dataclass(frozen=True)
class Event:
    """One fault.

    Parameters
    ----------
    step
        Number of the step, from the start of the world, before which it happens.
    kind
        One of `KINDS`.
    value
        Its meaning depends on the kind: milliseconds, a number of bytes, or a choice.
    after
        If it is not 0, ``step`` counts from the start of the program that is started after so many
        others have ended.
    flush
        Whether it waits for the next flush of a file or folder, where a real program spends much of
        its time.
    """

    step: int
    kind: str
    value: int = 0
    after: int = 0
    flush: bool = False


# Without double-led: which wire has two LEDs, only a self-test can find out.
_BOARD = (
    *("drop-command", "double-command", "corrupt-command", "lose-byte-command"),
    *("double-byte-command", "drop-reply", "double-reply", "corrupt-reply", "lose-byte-reply"),
    *("double-byte-reply", "delay-reply", "banner", "wrong-led", "goes-dark"),
    *("reset", "reset-after", "boot-loader", "hang-up", "die", "lose-trigger", "double-trigger"),
)
# The weight of each kind: most recordings meet many small faults, and few that end a program.
KINDS: dict[str, float] = {
    **{f"board:{kind}": 1.0 for kind in _BOARD},
    "board:goes-dark": 4.0,
    "board:lose-trigger": 3.0,
    "board:double-trigger": 3.0,
    "lamp:dark": 2.0,
    "board:brown-out": 4.0,
    "board:away": 2.0,
    "wire:stray-trigger": 3.0,
    "line:garbage": 3.0,
    "line:delay": 2.0,
    "line:split": 3.0,
    "camera:lost": 2.0,
    "camera:late": 1.0,
    "camera:twice": 2.0,
    "camera:wrong-size": 1.0,
    "camera:unplug": 1.0,
    "camera:away": 2.0,
    "disk:full": 2.0,
    "disk:read-only": 1.0,
    "disk:flush-fails": 2.0,
    "disk:slow": 2.0,
    "disk:short-write": 2.0,
    "disk:rot": 3.0,
    "disk:lost-file": 2.0,
    "host:busy": 3.0,
    "host:clock-step": 2.0,
    "host:power-loss": 3.0,
    "program:SIGINT": 2.0,
    "program:SIGTERM": 2.0,
    "program:SIGHUP": 1.0,
    "program:SIGKILL": 4.0,
    "program:second": 2.0,
}


@dataclass(frozen=True)
class Schedule:
    """A world that can be repeated.

    Parameters
    ----------
    seed
        Seed of all choices that are no events.
    events
        The faults, by step.
    """

    seed: int
    events: tuple[Event, ...]

    @classmethod
    def drawn(cls, seed: int) -> Schedule:
        """Draw about ten faults."""
        generator = random.Random(f"schedule {VERSION} {seed}")
        kinds, weights = list(KINDS), list(KINDS.values())
        chosen = generator.choices(kinds, weights, k=generator.randint(*_FAULTS))
        events = []
        for kind in chosen:
            starts = [(0, _STEPS)]
            if generator.random() < _RECUR:
                starts.append((generator.randint(1, _MOST_AFTER), _RECOVERY_STEPS))
            for after, steps in starts:
                step, value = generator.randrange(steps), generator.randint(1, MOST)
                events.append(Event(step, kind, value, after, generator.random() < _AT_FLUSH))
        return cls(seed, tuple(sorted(events, key=lambda event: event.step)))

    def to_json(self) -> str:
        """Return the text of a schedule file."""
        events = [asdict(event) for event in self.events]
        return json.dumps({"version": VERSION, "seed": self.seed, "events": events}, indent=1)

    @classmethod
    def read(cls, path: Path) -> Schedule:
        """Read a schedule file.

        Raises
        ------
        DataError
            If it is unreadable, of another version, or has an unknown event.
        """
        try:
            content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            version, events = content["version"], [Event(**one) for one in content["events"]]
            schedule = cls(int(content["seed"]), tuple(events))
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise DataError(f"{path}: is not a schedule file ({error})") from error
        if version != VERSION:
            raise DataError(
                f"{path}: is a schedule of version {version}, this program replays version "
                f"{VERSION}: draw a new one"
            )
        unknown = [event.kind for event in events if event.kind not in KINDS]
        if unknown:
            raise DataError(
                f"{path}: has an unknown event {unknown[0]!r}; known are {', '.join(KINDS)}"
            )
        return schedule

    def shrunk(self, fails: Callable[[Schedule], bool]) -> Schedule:
        """Return a schedule with fewer events that still fails."""
        events, size = list(self.events), max(1, len(self.events) // 2)
        while size:
            at, smaller = 0, False
            while at < len(events):
                fewer = events[:at] + events[at + size :]
                if fails(Schedule(self.seed, tuple(fewer))):
                    events, smaller = fewer, True
                else:
                    at += size
            if not smaller:
                size //= 2
        return Schedule(self.seed, tuple(events))
