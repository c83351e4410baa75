"""What every LED board must do, by docs/serial-protocol.md, as named checks on a running program.

A check is a function of a `BoardUnderTest`, the program that is the board: the virtual board, the
firmware as a Linux program, its AVR image in a simulator. `CHECKS` has them all by name. As tests::

    @pytest.mark.parametrize("name", CHECKS)
    def test_board(board, name):
        check(board, name)

and of a board that has a fault planted in it::

    with BoardUnderTest(command, late_us=50_000) as board:
        failures = run_checks(board, ["the requested LED turns on"])
        assert failures

Times are judged by the program's own events. ``late_us`` says how late an edge of it may be: 20
where its clock is simulated, tens of thousands where other programs compete for the processor.
"""

from __future__ import annotations

from collections.abc import Iterable

from tests.rig.conformance import commands, flash, lines, repetition, sequence, watchdog
from tests.rig.conformance._check import CHECKS
from tests.rig.conformance.board import BoardUnderTest

__all__ = [
    "CHECKS",
    "BoardUnderTest",
    "check",
    "commands",
    "flash",
    "lines",
    "repetition",
    "run_checks",
    "sequence",
    "watchdog",
]


def check(board: BoardUnderTest, name: str) -> None:
    """Run one check on an idle board; what the board does wrong is an AssertionError."""
    board.prepare()
    CHECKS[name](board)


def run_checks(board: BoardUnderTest, names: Iterable[str] | None = None) -> list[str]:
    """Run checks, all of them by default, and return a line for each that failed."""
    failures = []
    for name in CHECKS if names is None else names:
        try:
            check(board, name)
        except (AssertionError, OSError, ValueError, IndexError) as error:
            failures.append(f"{name}: {error}")
    return failures
