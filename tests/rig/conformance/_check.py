"""The list of checks."""

from __future__ import annotations

from collections.abc import Callable

from tests.rig.conformance.board import BoardUnderTest

Check = Callable[[BoardUnderTest], None]
CHECKS: dict[str, Check] = {}


def check(name: str) -> Callable[[Check], Check]:
    """Add a function to the list under a name that states what a board must do."""

    def enter(function: Check) -> Check:
        assert name not in CHECKS, name
        CHECKS[name] = function
        return function

    return enter
