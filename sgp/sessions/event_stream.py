"""The events of a recording as lines of JSON on stdout, as docs/commands.md lists them."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final

from cyclopts import Parameter

import acquisition
import rig as rigs
from rig.host import clock
from sgp.cli.console import listen
from sgp.results import Result, plain, verdict_record
from sgp.sessions.audience import Audience

VERSION: Final = 1
# Stage of `RecordingHooks.on_progress` whose steps are frames.
_RECORDING: Final = "recording"
Events = Annotated[bool, Parameter(negative=())]
_OF_FRAME: Final = ("file", "role", "led", "bracket", "repeat", "exposure_us", "clipped_fraction")


class EventStream(Audience):
    """Writes events to stdout from its creation until the end of the command line.

    The console states its notices and its progress to it.
    """

    def __init__(self) -> None:
        self._frame: acquisition.session.FrameLine | None = None
        self._began: tuple[float, int] | None = None
        listen(self)

    def started(
        self,
        session: Path,
        rig: str,
        plan: acquisition.CapturePlan,
        shots: Sequence[acquisition.plan.PlannedShot],
    ) -> None:
        """State what is recorded, and which shots are taken."""
        files = [shot.file for shot in shots]
        stated = plan.model_dump(mode="json")
        write_event("started", session=session, rig=rig, plan=stated, shots=files)

    def on_frame(self, line: acquisition.session.FrameLine) -> None:
        """Keep the line of a frame until its progress is known, which follows."""
        self._frame = line

    def progress(self, stage: str, done: int, total: int, /) -> None:
        """State a step; one of the recording is a frame."""
        if stage != _RECORDING:
            write_event("progress", stage=stage, done=done, total=total)
        elif self._frame is not None:
            frame = {name: getattr(self._frame, name) for name in _OF_FRAME}
            frame["file"] = self._frame.file.removeprefix("frames/")
            left_s = self._seconds_left(done, total)
            write_event("frame", **frame, done=done, total=total, seconds_left=left_s)

    def _seconds_left(self, done: int, total: int) -> float | None:
        now_s = clock.monotonic()
        began_s, first = self._began = self._began or (now_s, done)
        if done == first:
            return None
        return round((now_s - began_s) * (total - done) / (done - first), 1)

    def journal(self, name: str, details: Mapping[str, Any]) -> None:
        """State an event of the journal."""
        write_event("journal", name=name, details=details)

    def notice(self, notice: rigs.Notice, /) -> None:
        """State a notice."""
        write_event("notice", **asdict(notice))

    @property
    def answers(self) -> bool:
        """Whether someone can answer questions: the stream does not."""
        return False

    def question(self, finding: rigs.Notice) -> bool:
        """State a question, which only ``--accept`` answers."""
        write_event("question", **asdict(finding))
        return False

    def card(self, stopping: Callable[[], bool]) -> None:
        """Give no answer."""


def write_finished(result: Result, exit_code: int) -> None:
    """State that the command ran to its end."""
    session = result.outputs.get("session")
    verdict = None if result.verdict is None else verdict_record(result.verdict)["verdict"]
    text = [*result.summary, *result.conclusion][-1]
    write_event("finished", session=session, verdict=verdict, text=text, exit_code=exit_code)


def write_event(event: str, **values: Any) -> None:
    """Write a line; a reader that has exited is not an error, and later lines are discarded."""
    stated = {"version": VERSION, "event": event, **values}
    try:
        if sys.stdout is not None:  # None if it was closed before the start
            sys.stdout.write(json.dumps(plain(stated), allow_nan=False) + "\n")
            sys.stdout.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)
