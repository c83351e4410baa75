"""Messages to the operator during a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Self

import acquisition
import rig as rigs
from sgp.cli.console import Stages, note
from sgp.cli.exit import UsageError
from sgp.cli.terminal import STDERR
from sgp.sessions.acceptance import Acceptance
from sgp.sessions.audience import CARD
from sgp.sessions.resume_command import ResumeCommand

_STOPPING = b"\nstopping after this shot; Ctrl-C again stops now\n"
# What the operator reads of an event, with its details.
_EVENTS = {
    "retake": "retake: {reason}",
    "no_light_seen": "LED {led} at {exposure_us:g} us: exposure time too short to see its light, "
    "which a longer exposure time showed",
    "paused": "the disk is slower than the camera: waiting for the disk, with all LEDs off",
    "device_lost": "waiting for the {device}: {reason}",
    "device_returned": "the {device} is back after {seconds:.0f} s: the recording continues",
    "set_aside": "set aside: {file}{kept}",
    "upgraded": "the session was upgraded to format {to_version}",
    "not_sequenced": "the plan requests a sequence, but shots are taken one by one: {reason}",
}


def event_text(event: str, details: Mapping[str, Any]) -> str | None:
    """Return the line about an event for the operator; None for one that does not concern them."""
    if event not in _EVENTS:
        return None
    kept = f", kept as {details['kept']}" if details.get("kept") else ""
    return _EVENTS[event].format_map({**details, "kept": kept})


class CaptureTalk:
    """Callbacks of a recording that show progress, events, and the state after an early end.

    Parameters
    ----------
    again
        Command that resumes the session.
    card_is_there
        True if only flat frames are missing: the operator who resumes has placed the card.
    accepting
        Answers to findings that make further frames useless. Its audience receives frames and
        events, and is asked for the white card.
    """

    def __init__(
        self,
        again: ResumeCommand,
        *,
        card_is_there: bool = False,
        accepting: Acceptance | None = None,
    ) -> None:
        self._accepting = accepting or Acceptance()
        self._audience = self._accepting.audience
        self._again = again
        self._card_is_there = card_is_there
        self._stopping = False
        self._damaged = False
        self.on_progress = Stages()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.on_progress.close()
        if error is not None and not isinstance(error, acquisition.SessionInUseError):
            self._report_state(error)

    @property
    def hooks(self) -> acquisition.RecordingHooks:
        """The callbacks, for a recording."""
        return acquisition.RecordingHooks(
            on_frame=self._audience.on_frame,
            on_progress=self.on_progress,
            on_event=self.on_event,
            on_stop=self.on_stop,
            on_damage=self.on_damage,
            accept=self._accepting,
            before_flats=self.before_flats,
        )

    def on_event(self, event: str, details: Mapping[str, Any]) -> None:
        """Report the events that concern the operator."""
        self._audience.journal(event, details)
        text = event_text(event, details)
        if text is not None:
            note(text)

    def on_damage(self, problem: str) -> None:
        """Report damage at once, while the object is still in place for a retake."""
        self._damaged = True
        note(f"damaged: {problem}")
        self._audience.notice(rigs.Notice("frame-damaged", problem, severity="error"))

    def on_stop(self) -> None:
        """Confirm Ctrl-C; this runs in a signal handler and does not use the console."""
        self._stopping = True
        with suppress(OSError, ValueError):
            os.write(STDERR.fileno(), _STOPPING)

    def before_flats(self) -> None:
        """Ask for the white card to be placed under the camera; Ctrl-C ends the wait."""
        placed = self._audience.card(lambda: self._stopping)
        if not (self._card_is_there if placed is None else placed):
            raise UsageError(f"{CARD}, then continue with `{self._again.text()}`")

    def _report_state(self, error: BaseException) -> None:
        """Report the state of a session that stopped; the error itself gives the reason."""
        try:
            session = acquisition.Session.open(self._again.session)
        except (acquisition.DataError, acquisition.MissingPathError):
            return  # nothing was recorded
        if session.complete:
            return
        # The engine adds a note to the error if the board did not answer.
        notes = getattr(error, "__notes__", ())
        again = self._again.text(retake_damaged=self._damaged)
        dark = not any("not confirmed off" in line for line in notes)
        missing = len(session.missing)
        if missing:
            there = sum(frame.path.is_file() for frame in session.frames)
            intact = rigs.pluralize(there, "frame is", "frames are")
            frames = "missing and damaged frames" if self._damaged else "missing frames"
            state = f"{intact} intact, {rigs.pluralize(missing, 'is', 'are')} missing"
            remedy = f"takes the {frames}"
        else:
            state = "all frames are recorded"
            remedy = "takes the damaged frames" if self._damaged else "completes the session"
        note(
            f"{self._again.session}: incomplete, {state}; "
            f"{'the LEDs are off' if dark else 'see below for the LEDs'}; "
            f"`{again}` {remedy}"
        )
