"""What the tasks of a station share with the screen: plan, progress, questions, results."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from acquisition.engine import StopRequest
from acquisition.engine.stop_request import StoppedError
from sgp.screen.plan_sheet import PlanSheet

_LOOK_S: Final = 0.05


class Desk:
    """What the tasks of a station share with the screen. Any thread may call its methods.

    Parameters
    ----------
    sheet
        The plan that tasks use.
    """

    def __init__(self, sheet: PlanSheet) -> None:
        self.sheet = sheet
        self.stop = StopRequest()
        self._lock = threading.RLock()
        self._changed: Callable[[], None] = lambda: None
        self._progress: dict[str, Any] | None = None
        self._stage_began: tuple[str, int, float] = ("", 0, 0.0)
        self._question: dict[str, Any] | None = None
        self._answer: bool | None = None
        self._questions = 0
        self._failure = ""
        self._shown: dict[str, Any] = {
            "checks": None,
            "metered": None,
            "notices": [],
            "recording": None,
            "look": None,
            "mm_per_px": None,
        }

    # Called by the task.

    def begin(self, stop: StopRequest, changed: Callable[[], None]) -> None:
        """Begin a task."""
        with self._lock:
            self.stop, self._changed = stop, changed
            self._end("")

    def end(self, failure: str = "") -> None:
        """End a task; state why it failed, if it did."""
        with self._lock:
            self._end(failure)

    def _end(self, failure: str) -> None:
        self._failure, self._progress, self._question = failure, None, None
        self._stage_began = ("", 0, 0.0)
        self._changed()

    def progress(self, stage: str, done: int, total: int, /) -> None:
        """Show the progress of a task that may end at any step.

        Raises
        ------
        StoppedError
            If a stop was requested.
        """
        self.show_progress(stage, done, total)
        if self.stop.asked:
            raise StoppedError(self.stop, "between two steps")

    def show_progress(self, stage: str, done: int, total: int, /) -> None:
        """Show the progress of a task."""
        now_s = time.monotonic()
        with self._lock:
            if self._stage_began[0] != stage:
                self._stage_began = stage, done, now_s
            _, first, began_s = self._stage_began
            left_s = (now_s - began_s) * (total - done) / (done - first) if done > first else None
            self._progress = {"stage": stage, "done": done, "total": total, "left_s": left_s}
            self._changed()

    def ask(self, text: str) -> bool:
        """Ask the operator, and return whether the answer was yes; no if a stop was requested."""
        with self._lock:
            self._questions += 1
            self._answer = None
            self._question = {"id": self._questions, "text": text}
            self._changed()
        while self._answer is None and not self.stop.asked:
            time.sleep(_LOOK_S)
        with self._lock:
            self._question = None
            self._changed()
        return bool(self._answer) and not self.stop.asked

    def show(self, **values: Any) -> None:
        """Show results, in JSON types, by their names."""
        with self._lock:
            self._shown.update(values)
            self._changed()

    # Called by the screen.

    def answer(self, question: int, yes: bool) -> None:
        """Answer a question; an answer to another than the one on display does nothing."""
        with self._lock:
            if self._question is not None and self._question["id"] == question:
                self._answer = yes

    def state(self) -> dict[str, Any]:
        """Return what the screen shows, in JSON types."""
        with self._lock:
            return {
                "plan": self.sheet.state(),
                "progress": self._progress,
                "question": self._question,
                "failure": self._failure,
                **self._shown,
            }
