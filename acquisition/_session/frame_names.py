"""File names of frames: each take has its own file, and no file is written twice."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from acquisition._plan.plan import CapturePlan
from acquisition._plan.planned_shot import PlannedShot


class FrameNames:
    """Assigns file names; safe to use from several threads.

    Parameters
    ----------
    folder
        Folder of the frames.
    plan
        Plan of the session; the numbers of its repeats are reserved for them.
    taken
        Names of recorded frames, even if their files no longer exist.
    """

    def __init__(self, folder: Path, plan: CapturePlan | None, taken: Iterable[str] = ()) -> None:
        self._folder = folder
        self._first_retake = 1 if plan is None else max(plan.repeats, plan.flats)
        self._taken = set(taken)
        self._lock = threading.Lock()

    @contextmanager
    def reserve(self, shot: PlannedShot) -> Iterator[Path]:
        """Reserve a path for the next take of a shot; after an error in the block it is free."""
        number, retake = shot.repeat, self._first_retake
        with self._lock:
            while True:
                path = self._folder / shot.take_file(number)
                if path.name not in self._taken and not path.exists():
                    break
                number, retake = retake, retake + 1
            self._taken.add(path.name)
        try:
            yield path
        except BaseException:
            # If the file exists by now, without a line, its name is still not used again.
            with self._lock:
                self._taken.discard(path.name)
            raise
