"""Planned shots that a session is still missing."""

from __future__ import annotations

from pathlib import Path

from acquisition._errors import DataError
from acquisition.plan.plan import CapturePlan
from acquisition.plan.planned_shot import PlannedShot
from acquisition.session.journal import EventLine, FrameLine, Line
from acquisition.session.session import Session
from rig.host import threads


class OpenShots:
    """The planned shots that are required and not recorded; safe to use from several threads.

    Parameters
    ----------
    plan
        Plan of the session; None for a session without a plan, which requires no shots.
    session
        The session as read from disk if it is resumed.
    """

    def __init__(self, plan: CapturePlan | None, session: Session | None = None) -> None:
        shots = () if plan is None else plan.shots()
        self._planned = None if plan is None else {shot.key: shot for shot in shots}
        self._missing = {shot.key: shot for shot in (shots if session is None else session.missing)}
        self._demanded = len(shots) - (0 if session is None else len(session.left_out))
        self._lock = threads.Lock()

    @property
    def missing(self) -> tuple[PlannedShot, ...]:
        """Planned shots that are required and not recorded yet, in plan order."""
        with self._lock:
            return tuple(self._missing.values())

    @property
    def demanded(self) -> int:
        """Number of shots of a complete session: all of the plan except those left out."""
        with self._lock:
            return self._demanded

    def planned(self, shot: PlannedShot, folder: Path) -> PlannedShot:
        """Return the planned shot with the same key; without a plan return the shot itself.

        Raises
        ------
        DataError
            If it is not in the plan of the session in ``folder``.
        """
        if self._planned is None:
            return shot
        if shot.key not in self._planned:
            raise DataError(f"{folder}: {shot.file} is not in the plan of this session")
        return self._planned[shot.key]

    def note(self, line: Line) -> None:
        """Update the missing shots after a line was written to the journal."""
        with self._lock:
            if isinstance(line, FrameLine) and line.status == "ok":
                self._missing.pop(line.key, None)
            elif isinstance(line, EventLine) and (dead := line.left_out):
                for shot in [s for s in self._missing.values() if s.led in dead]:
                    del self._missing[shot.key]
                    self._demanded -= 1
