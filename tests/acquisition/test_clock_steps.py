"""Times of a journal that cannot all be right."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from acquisition.session import EventLine, Journal, Manifest, RigRecord
from acquisition.session.clock_steps import clock_steps
from tests.cases import cases

STARTED = datetime(2026, 3, 14, 9, 26, tzinfo=UTC)
RIG = RigRecord(name="dome", driver="bench", board="b", protocol="2", firmware="1", leds=4)
MANIFEST = Manifest.begin(
    "s", camera={"width": 8, "height": 6, "bit_depth": 12}, rig=RIG
).model_copy(update={"started_utc": STARTED})


def journal(*events: tuple[float, str]) -> Journal:
    """Return a journal of events at hours after the start."""
    lines = (
        EventLine(
            seq=seq,
            time_utc=(STARTED + timedelta(hours=hours)).isoformat(),
            event=event,
            details={},
        )
        for seq, (hours, event) in enumerate(events)
    )
    return Journal(tuple(lines), b"", "")


@cases(
    ("events", "said"),
    {
        "paused for a day": ([(0, "a"), (0.1, "b"), (23, "c")], None),
        "corrected by minutes": ([(0, "a"), (0.01, "b"), (-0.05, "c")], None),
        "resumed after months": ([(0, "a"), (8000, "reopened"), (8001, "c")], None),
        "back by an hour": ([(0, "a"), (-1, "b")], "08:26 UTC before line 2:"),
        "before the start": ([(-200_000, "a")], "before line 1:"),
        "on by a day": ([(0, "a"), (30, "b")], "before line 2:"),
        "resumed after years": ([(0, "a"), (9000, "reopened")], "before line 2:"),
        "resumed before": ([(0, "a"), (-1, "reopened")], "before line 2:"),
        "there and back": ([(0, "a"), (90, "b"), (1, "c")], "before line 2, and 1 more time:"),
    },
)
def test_steps_are_named_once(events: list[tuple[float, str]], said: str | None) -> None:
    found = clock_steps(Path("s"), MANIFEST, journal(*events))
    assert [notice.code for notice in found] == ([] if said is None else ["clock-stepped"])
    assert said is None or said in found[0].text


def test_imported_sessions_have_the_times_of_their_import() -> None:
    imported = MANIFEST.model_copy(update={"rig": None})
    assert clock_steps(Path("s"), imported, journal((0, "a"), (-90_000, "b"))) == []
