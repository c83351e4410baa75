"""Named checks of a running board program against docs/serial-protocol.md.

A check is a function of a `BoardUnderTest`, the program that acts as the board: the virtual board,
the firmware as a Linux program, or its AVR image in a simulator. `CHECKS` has all checks by name.
Use as tests::

    @pytest.mark.parametrize("name", CHECKS)
    def test_board(board, name):
        check(board, name)

and for a board with a planted fault::

    with BoardUnderTest(command, late_us=50_000) as board:
        failures = run_checks(board, ["the requested LED turns on"])
        assert failures

Times are checked by the program's own events. ``late_us`` is how late its edges may be: 20 if its
clock is simulated, tens of thousands if other programs compete for the processor.
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
    """Run one check on an idle board; a failure is an AssertionError."""
    board.prepare()
    CHECKS[name](board)


def run_checks(
    board: BoardUnderTest, names: Iterable[str] | None = None, *, attempts: int = 1
) -> list[str]:
    """Run checks, all of them by default, and return a line for each that failed.

    A program that shares the processor with others may be late once, but a fault of the board is
    there each time: a check fails if all ``attempts`` fail.
    """
    failures = []
    for name in CHECKS if names is None else names:
        for left in reversed(range(attempts)):
            try:
                check(board, name)
                break
            except (AssertionError, OSError, ValueError, IndexError) as error:
                if not left:
                    failures.append(f"{name}: {error}")
    return failures
