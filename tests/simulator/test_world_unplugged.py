"""Recordings in virtual time whose board and camera are unplugged and come back."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path

import pytest

from simulator.world import Event, Schedule, Trial
from simulator.world.invariants import SessionState

EACH = 4
# Eighths of a second; all absences of a recording together are shorter than it waits.
AWAY = (1, 2, 5, 20, 50)


def drawn(seed: int) -> Schedule:
    """Return a schedule that unplugs devices between the first shot and the last."""
    generator = random.Random(f"unplugged {seed}")
    kinds = ("board:away", "camera:away")
    events = [
        Event(generator.randrange(100, 900), generator.choice(kinds), generator.choice(AWAY))
        for _ in range(EACH)
    ]
    return Schedule(seed, tuple(sorted(events, key=lambda event: event.step)))


@pytest.mark.parametrize("first", range(0, 50, 10))
def test_a_recording_goes_on_when_board_and_camera_are_back(first: int, tmp_path: Path) -> None:
    reported: Counter[str] = Counter()
    for seed in range(first, first + 10):
        (tmp_path / str(seed)).mkdir()
        trial = Trial(drawn(seed), tmp_path / str(seed))
        outcome = trial.run()
        assert outcome.violations == ()
        # No operator had to resume it.
        assert (outcome.programs, len(outcome.met)) == (1, EACH)
        events = [line for line in SessionState.read(trial.session).lines if "event" in line]
        reported.update(f"{line['event']} {line['details'].get('device')}" for line in events)
        assert not any(line["event"] == "retake" for line in events)
    for device in ("board", "camera"):
        assert reported[f"device_lost {device}"] == reported[f"device_returned {device}"] > 4
