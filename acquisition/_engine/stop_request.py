"""Ctrl-C while shots are taken: once stops after the current shot, twice stops immediately."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Self


class StopRequest:
    """Handles SIGINT inside its ``with`` block, on the main thread, unless SIGINT is ignored.

    Parameters
    ----------
    on_stop
        Called at the first Ctrl-C inside the signal handler, so it must be brief and safe there.
    """

    def __init__(self, on_stop: Callable[[], None] | None = None) -> None:
        self.asked = False
        self._on_stop = on_stop
        self._before: Any = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            before = signal.getsignal(signal.SIGINT)
            if callable(before):
                self._before = before
                signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
            self._before = None

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.asked:
            self._before(number, frame)
            # The previous handler may return; the recording ends in any case.
            raise KeyboardInterrupt
        self.asked = True
        if self._on_stop is not None:
            self._on_stop()
