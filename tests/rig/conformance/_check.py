"""The list of checks."""

from __future__ import annotations

from collections.abc import Callable

from tests.rig.conformance.board import BoardUnderTest

Check = Callable[[BoardUnderTest], None]
CHECKS: dict[str, Check] = {}


def check(name: str) -> Callable[[Check], Check]:
    """Enter a function into the list under a name that says what a board must do."""

    def enter(function: Check) -> Check:
        assert name not in CHECKS, name
        CHECKS[name] = function
        return function

    return enter
