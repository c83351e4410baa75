"""One line and a moving bar while kernels are compiled, which happens once."""

from __future__ import annotations

from contextlib import ExitStack

import rig
from sgp._console import busy, note

_TEXT = "compiling kernels for this computer, once; this takes up to two minutes"


class Compiling(rig.KernelWatch):
    """Reports on stderr that kernels are compiled, or that they cannot be kept."""

    def __init__(self) -> None:
        self._stated = False
        self._bar = ExitStack()

    def compiling(self, active: int) -> None:
        """Show a bar while a kernel is compiled, and a line at the first."""
        if active and not self._stated:
            self._stated = True
            note(_TEXT)
        if active == 0:
            self._bar.close()
        elif active == 1:
            self._bar.enter_context(busy("compiling kernels"))

    def uncached(self, reason: str) -> None:
        """State that kernels cannot be kept, which also says that they are compiled."""
        self._stated = True
        note(f"note: {reason}")
