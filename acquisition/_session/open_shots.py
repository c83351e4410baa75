"""Which shots of its plan a session has yet to get."""

from __future__ import annotations

import threading

from acquisition._plan.plan import CapturePlan
from acquisition._plan.planned_shot import PlannedShot, ShotKey
from acquisition._session.journal import EventLine, FrameLine, Line
from acquisition._session.session import Session


class OpenShots:
    """The planned shots that are demanded and not recorded; safe to use from several threads.

    Parameters
    ----------
    plan
        Of the session; None for one without a plan, which demands nothing.
    begun
        The session as it was found, where it is gone on with.
    """

    def __init__(self, plan: CapturePlan | None, begun: Session | None = None) -> None:
        shots = () if plan is None else plan.shots()
        self._planned = None if plan is None else {shot.key for shot in shots}
        self._missing = {shot.key: shot for shot in (shots if begun is None else begun.missing)}
        self._demanded = len(shots) - (0 if begun is None else len(begun.left_out))
        self._lock = threading.Lock()

    @property
    def missing(self) -> tuple[PlannedShot, ...]:
        """Planned shots that are demanded and not recorded yet, in plan order."""
        with self._lock:
            return tuple(self._missing.values())

    @property
    def demanded(self) -> int:
        """How many shots there must be in the end: all of the plan, less those left out."""
        with self._lock:
            return self._demanded

    def may_have(self, key: ShotKey) -> bool:
        """Tell whether a shot is in the plan; without a plan every shot may be recorded."""
        return self._planned is None or key in self._planned

    def note(self, line: Line) -> None:
        """Take a line of the journal into account that was written just now."""
        with self._lock:
            if isinstance(line, FrameLine) and line.status == "ok":
                self._missing.pop(line.key, None)
            elif isinstance(line, EventLine) and (dead := line.left_out):
                for shot in [s for s in self._missing.values() if s.lit_led in dead]:
                    del self._missing[shot.key]
                    self._demanded -= 1
