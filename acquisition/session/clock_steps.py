"""Steps of the computer's clock while a session was recorded."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from acquisition.session.journal import REOPENED, EventLine, Journal, Line
from acquisition.session.layout import JOURNAL
from acquisition.session.manifest import Manifest
from rig import Notice, pluralize

# Corrections by a time server are smaller; hands and empty batteries move a clock by hours.
_BACK: Final = timedelta(minutes=5)
# Between two shots of a recording that was not interrupted nothing waits as long as this.
_ON: Final = timedelta(days=1)
# Between an interruption and the continuation, a pause of any length up to this is plausible.
_ON_REOPENED: Final = timedelta(days=366)


def clock_steps(folder: Path, manifest: Manifest, journal: Journal) -> list[Notice]:
    """Return a notice if the times of a recording cannot all be right.

    The order of lines is given by their numbers, so that nothing but the times is in doubt. Times
    of imported sessions are those of the import.

    Parameters
    ----------
    folder
        The session.
    manifest, journal
        Its ``session.toml`` and the valid part of its journal.
    """
    if manifest.rig is None:
        return []
    steps = []
    before = manifest.started_utc
    for line in journal.lines:
        now = _time(line)
        reopened = isinstance(line, EventLine) and line.event == REOPENED
        step = now - before
        if step < -_BACK or step > (_ON_REOPENED if reopened else _ON):
            steps.append((line.seq + 1, before, now))
        before = now
    if not steps:
        return []
    number, before, now = steps[0]
    more = f", and {pluralize(len(steps) - 1, 'more time')}" if len(steps) > 1 else ""
    text = (
        f"the clock of the computer stepped from {before:%Y-%m-%d %H:%M} to {now:%Y-%m-%d %H:%M} "
        f"UTC before line {number}{more}: the frames are intact, but do not rely on their times"
    )
    return [Notice("clock-stepped", text, str(folder / JOURNAL))]


def _time(line: Line) -> datetime:
    time = datetime.fromisoformat(line.time_utc)
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time
