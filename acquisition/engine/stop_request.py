"""The request to end a recording after the current shot."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from rig.host import program, threads


class StopRequest:
    """Request to end a recording after the current shot: by a call of any thread, or by Ctrl-C.

    Attributes
    ----------
    asked_by
        Who requested it first, for the record; empty until then.
    """

    def __init__(self) -> None:
        self.asked_by = ""

    @property
    def asked(self) -> bool:
        """Whether the recording should end."""
        return self.asked_by != ""

    def ask(self, by: str) -> None:
        """Request the end. Further requests change nothing."""
        self.asked_by = self.asked_by or by

    @contextmanager
    def by_ctrl_c(self, on_stop: Callable[[], None]) -> Iterator[None]:
        """Make SIGINT such a request inside the block, on the main thread, unless it is ignored.

        A second SIGINT raises KeyboardInterrupt.

        Parameters
        ----------
        on_stop
            Called at the first one inside the signal handler, so it must be brief and safe there.
        """
        before = program.handler_of(signal.SIGINT) if threads.is_main() else None
        if not callable(before):
            yield
            return

        def handle(number: int, frame: FrameType | None) -> None:
            if self.asked:
                before(number, frame)
                # The previous handler may return; the recording ends in any case.
                raise KeyboardInterrupt
            self.ask("Ctrl-C")
            on_stop()

        program.handle(signal.SIGINT, handle)
        try:
            yield
        finally:
            program.handle(signal.SIGINT, before)


class StoppedError(KeyboardInterrupt):
    """A stop was requested: the last shot is complete, and pending writes may finish."""

    def __init__(self, stop: StopRequest, when: str) -> None:
        super().__init__(f"stopped by {stop.asked_by} {when}")
