"""Who follows a recording and answers its questions: by default the operator at the terminal."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import acquisition
import rig as rigs
from sgp.cli.console import Listener, note

if sys.platform != "win32":
    import termios

CARD = "flat frames are next: put the white card under the camera"
# Interval at which a prompt checks whether Ctrl-C was pressed.
_LOOK_S = 0.2


class Audience(Listener):
    """Those who follow a recording; this one is the operator at the terminal, if there is one."""

    def started(
        self,
        session: Path,
        rig: str,
        plan: acquisition.CapturePlan,
        shots: Sequence[acquisition.plan.PlannedShot],
    ) -> None:
        """Hear what is recorded, and which shots are taken."""

    def on_frame(self, line: acquisition.session.FrameLine) -> None:
        """Hear of a frame that counts."""

    def journal(self, name: str, details: Mapping[str, Any]) -> None:
        """Hear of an event of the journal."""

    @property
    def answers(self) -> bool:
        """Whether someone can answer questions."""
        return _is_attended()

    def question(self, finding: rigs.Notice) -> bool:
        """Return whether to continue after a finding."""
        if not _is_attended():
            return False
        _forget_keys()
        note(f"{finding}")
        note("continue anyway? type yes and press Enter; any other answer stops")
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def card(self, stopping: Callable[[], bool]) -> bool | None:
        """Return True when the white card is in place or a stop is requested; None without answer.

        Parameters
        ----------
        stopping
            Returns whether a stop was requested.
        """
        if not _is_attended():
            return None
        _forget_keys()
        note(f"{CARD}, then press Enter")
        # On Windows, select() does not support the console.
        while sys.platform != "win32" and not select.select([sys.stdin], [], [], _LOOK_S)[0]:
            if stopping():
                return True
        return sys.stdin.readline() != ""


def _is_attended() -> bool:
    """Return whether an operator can answer questions."""
    return sys.stdin is not None and sys.stdin.isatty()


def _forget_keys() -> None:
    """Discard keys that were pressed before a question: they do not answer it."""
    if sys.platform != "win32":
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
