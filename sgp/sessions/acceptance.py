"""Findings that make a recording useless: accepted by an option, or by the operator."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated, Literal

from cyclopts import Parameter

import acquisition
import rig as rigs
from sgp.cli.console import note
from sgp.sessions.event_stream import EventStream

if sys.platform != "win32":
    import termios

Code = Literal[
    "exposure-saturated",
    "exposure-too-dark",
    "frame-shifted",
    "light-lost",
    "object-changed",
    "room-light-strong",
]
Accepted = Annotated[tuple[Code, ...], Parameter(negative=(), consume_multiple=False)]


class Acceptance:
    """Answers whether to continue after findings that make a recording useless.

    Parameters
    ----------
    codes
        Codes of the findings that are accepted; the operator is asked about others if the command
        is used on a terminal.
    stream
        Receives the questions in place of the operator.
    """

    def __init__(self, codes: Sequence[Code] = (), stream: EventStream | None = None) -> None:
        self._codes = codes
        self._stream = stream

    def __call__(self, finding: rigs.Notice) -> bool:
        """Return whether a finding is accepted."""
        if finding.code in self._codes:
            return True
        if self._stream is not None:
            self._stream.question(finding)
            return False
        if not is_attended():
            return False
        forget_keys()
        note(f"{finding}")
        note("continue anyway? type yes and press Enter; any other answer stops")
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def require(self, finding: rigs.Notice) -> None:
        """Refuse a finding that is not accepted.

        Raises
        ------
        NotAcceptedError
            If it is not accepted.
        """
        if not self(finding):
            raise acquisition.NotAcceptedError(finding)


def is_attended() -> bool:
    """Return whether an operator can answer questions."""
    return sys.stdin is not None and sys.stdin.isatty()


def forget_keys() -> None:
    """Discard keys that were pressed before a question: they do not answer it."""
    if sys.platform != "win32":
        termios.tcflush(sys.stdin, termios.TCIFLUSH)
