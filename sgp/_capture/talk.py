"""What is said to the operator while a recording goes on."""

from __future__ import annotations

import os
import select
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from acquisition import DataError, MissingPathError, Session, SessionInUseError
from sgp._console import Stages, note
from sgp._exit import UsageError
from sgp._stderr import STDERR

if sys.platform != "win32":
    import termios

_STOPPING = b"\nstopping after this shot; Ctrl-C again stops now\n"
# How often a prompt looks whether Ctrl-C was pressed meanwhile.
_LOOK_S = 0.2
_CARD = "flat frames are next: put the white card under the camera"


class CaptureTalk:
    """Progress, events and, where it ends early, what is left; the hooks of a recording.

    Parameters
    ----------
    out
        The session.
    card_is_there
        Flat frames are all that is missing: whoever goes on has put the card there.
    """

    def __init__(self, out: Path, *, card_is_there: bool = False) -> None:
        self._out = out
        self._card_is_there = card_is_there
        self._stopping = False
        self._damaged = False
        self.on_progress = Stages()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.on_progress.close()
        if error is not None and not isinstance(error, SessionInUseError):
            self._tell_what_is_left(error)

    def on_event(self, event: str, details: Mapping[str, Any]) -> None:
        """Say what happened, where an operator wants to know."""
        match event:
            case "retake":
                note(f"again: {details['reason']}")
            case "no_light_seen":
                note(
                    f"LED {details['led']} at {details['exposure_us']:g} us: too short to show its "
                    "light, which a longer exposure showed"
                )
            case "paused":
                note("the disk is slower than the camera: waiting for it, with all LEDs off")
            case "set_aside":
                kept = f", kept as {details['kept']}" if details["kept"] else ""
                note(f"set aside: {details['file']}{kept}")
            case "upgraded":
                note(f"the session has format {details['to_version']} from here on")
            case "not_sequenced":
                note(
                    f"the plan asks for a sequence, shots are taken one by one: {details['reason']}"
                )

    def on_damage(self, problem: str) -> None:
        """Say at once what an operator can do something about while the object is there."""
        self._damaged = True
        note(f"damaged: {problem}")

    def on_stop(self) -> None:
        """Say that Ctrl-C was understood; inside a signal handler, so without the console."""
        self._stopping = True
        with suppress(OSError, ValueError):
            os.write(STDERR.fileno(), _STOPPING)

    def before_flats(self) -> None:
        """Have the white card put under the camera; Ctrl-C ends the waiting."""
        asked = sys.stdin is not None and sys.stdin.isatty()
        if asked:
            _forget_keys()
            note(f"{_CARD}, then press Enter")
        if not (self._enter_is_pressed() if asked else self._card_is_there):
            raise UsageError(f"{_CARD}, then go on with `capture resume {self._out}`")

    def _enter_is_pressed(self) -> bool:
        """Wait for it; False where the terminal was closed instead."""
        # There the console cannot be waited for with a time limit.
        while sys.platform != "win32" and not select.select([sys.stdin], [], [], _LOOK_S)[0]:
            if self._stopping:
                return True
        return sys.stdin.readline() != ""

    def _tell_what_is_left(self, error: BaseException) -> None:
        """Say what a capture that stopped has left; why it stopped is said by the error itself."""
        try:
            session = Session.open(self._out)
        except (DataError, MissingPathError):
            return  # nothing had been recorded
        if session.complete:
            return
        # The engine adds a note to the error where the board did not answer.
        told = getattr(error, "__notes__", ())
        option = " --retake-damaged" if self._damaged else ""
        more = " and what is damaged" if self._damaged else ""
        dark = not any("not confirmed off" in line for line in told)
        note(
            f"{self._out}: incomplete, {len(session.frames)} frames are whole, "
            f"{len(session.missing)} are missing; "
            f"{'the LEDs are off' if dark else 'see below for the LEDs'}; "
            f"`capture resume {self._out}{option}` takes what is missing{more}"
        )


def _forget_keys() -> None:
    """Forget keys that were pressed before they were asked for: they say nothing of the card."""
    if sys.platform != "win32":
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
