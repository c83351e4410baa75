"""The shots still to take, each after the shots that it is compared with."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from acquisition.plan.planned_shot import PlannedShot


class Agenda:
    """Remaining shots of a plan, in order.

    Parameters
    ----------
    shots
        Shots in the order of the plan.
    """

    def __init__(self, shots: Iterable[PlannedShot]) -> None:
        self._shots = deque(shots)

    def __len__(self) -> int:
        return len(self._shots)

    @property
    def first(self) -> PlannedShot:
        """The next shot; at least one must be left."""
        return self._shots[0]

    @property
    def lights_left(self) -> bool:
        """Whether a light is among the shots."""
        return any(shot.role == "light" for shot in self._shots)

    def take(self, also: Callable[[PlannedShot], bool] = lambda shot: False) -> deque[PlannedShot]:
        """Remove and return the next shot and the shots right after it for which ``also`` holds."""
        taken = deque([self._shots.popleft()])
        while self._shots and also(self._shots[0]):
            taken.append(self._shots.popleft())
        return taken

    def put_back(self, shots: deque[PlannedShot]) -> None:
        """Put shots that were removed but not taken back in front of all others."""
        self._shots.extendleft(reversed(shots))

    def again(self, shot: PlannedShot) -> None:
        """Add a rejected shot again: before the shots compared with it, otherwise at the end.

        The last repeat stays after all lights, an earlier one is taken next. Flats stay after all
        others, since the white card covers the object for them.
        """
        if shot.role == "repeat" and any(left.role == "repeat" for left in self._shots):
            self._shots.appendleft(shot)
            return
        end = len(self._shots)
        while end and _rank(self._shots[end - 1]) > _rank(shot):
            end -= 1
        judged = (i for i, left in enumerate(self._shots) if _is_compared(left, shot))
        self._shots.insert(min(next(judged, end), end), shot)


def _rank(shot: PlannedShot) -> int:
    """Return the place of a role that is taken after the others."""
    return {"repeat": 1, "flat": 2}.get(shot.role, 0)


def _is_compared(shot: PlannedShot, other: PlannedShot) -> bool:
    """Return whether ``other`` is the dark frame, or a longer exposure of the LED, of a shot."""
    if shot.led is None or shot.exposure_us is None or other.exposure_us is None:
        return False
    if other.led is None:
        return shot.exposure_us == other.exposure_us
    same = (shot.role, shot.led) == (other.role, other.led)
    return same and shot.exposure_us < other.exposure_us
