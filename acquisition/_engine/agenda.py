"""The shots that are still to be taken, each behind those that it is judged by."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable

from acquisition._plan.planned_shot import PlannedShot


class Agenda:
    """What is left of a plan, in order.

    Parameters
    ----------
    shots
        In the order of the plan.
    """

    def __init__(self, shots: Iterable[PlannedShot]) -> None:
        self._shots = deque(shots)

    def __len__(self) -> int:
        return len(self._shots)

    @property
    def first(self) -> PlannedShot:
        """The next shot; there is one."""
        return self._shots[0]

    def take(self, also: Callable[[PlannedShot], bool] = lambda shot: False) -> deque[PlannedShot]:
        """Take the next shot off, and those right behind it that belong to it."""
        taken = deque([self._shots.popleft()])
        while self._shots and also(self._shots[0]):
            taken.append(self._shots.popleft())
        return taken

    def put_back(self, shots: deque[PlannedShot]) -> None:
        """Put shots that were taken off, and not taken, before all others."""
        self._shots.extendleft(reversed(shots))

    def again(self, shot: PlannedShot) -> None:
        """Add a shot that was rejected: before those judged by it, else behind its kind.

        All but flats come before the white card.
        """
        flats = sum(left.role == "flat" for left in self._shots)
        end = len(self._shots) - (0 if shot.role == "flat" else flats)
        judged = (i for i, left in enumerate(self._shots) if _judged_by(left, shot))
        self._shots.insert(min(next(judged, end), end), shot)


def _judged_by(shot: PlannedShot, other: PlannedShot) -> bool:
    """Tell whether the other is the dark of a shot, or what its LED gave at a longer exposure."""
    if shot.lit_led is None or shot.exposure_us is None or other.exposure_us is None:
        return False
    if other.lit_led is None:
        return shot.exposure_us == other.exposure_us
    same = (shot.role, shot.lit_led) == (other.role, other.lit_led)
    return same and shot.exposure_us < other.exposure_us
