"""Recordings for the screen: those of `capture run` and `capture resume`, followed here."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import acquisition
import rig as rigs
from sgp.cli.console import forget_reports, listen
from sgp.results import Result
from sgp.screen.desk import Desk
from sgp.screen.tasks import Task, noticed
from sgp.sessions import (
    Acceptance,
    Audience,
    Order,
    ResumeCommand,
    event_text,
    record_on_rig,
    resume_on_rig,
)

_MOST_LINES: Final = 200


class ShownRecording(Audience):
    """A recording as the screen shows it; the operator answers there.

    Parameters
    ----------
    desk
        Where it is shown.
    folder
        The session.
    lines
        Its frames so far.
    """

    def __init__(
        self, desk: Desk, folder: Path, lines: Sequence[acquisition.session.FrameLine] = ()
    ) -> None:
        self._desk, self._folder = desk, folder
        self._lock = threading.Lock()
        self._frames = [_described(line) for line in lines]
        self._lines: list[dict[str, Any]] = []
        self._state, self._verdict, self._started = "running", "", False
        forget_reports()
        listen(self)
        self._show()

    def notice(self, notice: rigs.Notice, /) -> None:
        """Show a notice."""
        self._say(noticed(notice))

    def progress(self, stage: str, done: int, total: int, /) -> None:
        """Show a step."""
        if self._started:
            self._desk.show_progress(stage, done, total)
        else:
            self._desk.progress(stage, done, total)

    def started(
        self,
        session: Path,
        rig: str,
        plan: acquisition.CapturePlan,
        shots: Sequence[acquisition.plan.PlannedShot],
    ) -> None:
        """Note that the checks are done: from now on, the engine ends the recording at a stop."""
        self._started = True

    def on_frame(self, line: acquisition.session.FrameLine) -> None:
        """Show a frame."""
        with self._lock:
            self._frames.append(_described(line))
        self._show()

    def journal(self, name: str, details: Mapping[str, Any]) -> None:
        """Show an event that concerns the operator."""
        text = event_text(name, details)
        if text is not None:
            self._say({"severity": "note", "text": text})

    @property
    def answers(self) -> bool:
        """Whether someone can answer questions: the page does."""
        return True

    def question(self, finding: rigs.Notice) -> bool:
        """Ask whether to continue after a finding."""
        self.notice(finding)
        return self._desk.ask(f"{finding}. Continue anyway?")

    def card(self, stopping: Callable[[], bool]) -> bool:
        """Ask for the white card; any other answer stops."""
        if not self._desk.ask("Flat frames are next: put the white card under the camera."):
            self._desk.stop.ask("the page")
        return True

    def end(self, result: Result | None) -> None:
        """Show how it ended; without a result, it failed or was stopped."""
        try:
            complete = acquisition.Session.open(self._folder).complete
            self._state = "complete" if complete else "incomplete"
        except (acquisition.DataError, acquisition.MissingPathError):
            self._state = "not begun"
        if result is not None:
            for warning in result.warnings:
                self._add(noticed(warning))
            self._verdict = " ".join(result.conclusion)
        self._show()

    def _say(self, line: dict[str, Any]) -> None:
        self._add(line)
        self._show()

    def _add(self, line: dict[str, Any]) -> None:
        with self._lock:
            if line not in self._lines:
                self._lines = [*self._lines, line][-_MOST_LINES:]

    def _show(self) -> None:
        with self._lock:
            shown = {
                "folder": str(self._folder),
                "state": self._state,
                "verdict": self._verdict,
                "frames": [*self._frames],
                "lines": [*self._lines],
            }
        self._desk.show(recording=shown)


def record(order: Order, labels: acquisition.Labels, out: Path, *, check: bool) -> Task:
    """Return a task that records a new session.

    Parameters
    ----------
    order, labels
        What the session stores.
    out
        New folder.
    check
        Whether to check rig and picture first.
    """

    def task(rig: rigs.Rig, desk: Desk) -> None:
        plan, left_out = desk.sheet.whole.without(rig.config.dead_leds)
        _follow(
            desk,
            ShownRecording(desk, out),
            lambda accepting: record_on_rig(
                rig,
                plan,
                left_out,
                out,
                order,
                labels,
                skip_check=not check,
                accepting=accepting,
                stop=desk.stop,
            ),
        )

    return task


def resume(order: Order, folder: Path) -> Task:
    """Return a task that takes the missing shots of a session."""

    def task(rig: rigs.Rig, desk: Desk) -> None:
        begun = acquisition.Session.open(folder)
        _follow(
            desk,
            ShownRecording(desk, folder, [frame.line for frame in begun.frames]),
            lambda accepting: resume_on_rig(
                rig,
                begun,
                ResumeCommand(folder, order.rig_name),
                accepting=accepting,
                stop=desk.stop,
            ),
        )

    return task


def _follow(desk: Desk, audience: ShownRecording, run: Callable[[Acceptance], Result]) -> None:
    desk.show(look=None)
    result = None
    try:
        result = run(Acceptance(audience=audience))
    finally:
        audience.end(result)
        forget_reports()


def _described(line: acquisition.session.FrameLine) -> dict[str, Any]:
    return {"file": Path(line.file).name, "role": line.role, "led": line.led}
