"""A thread that copies frames out of a camera's buffers while the program is busy."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rig._errors import CameraError

_POLL_S = 0.001


class Collector:
    """A thread that collects frames from `begin` to `end`.

    Parameters
    ----------
    collect
        Takes one frame and returns True; returns False if there is no frame or no room.
    """

    def __init__(self, collect: Callable[[], bool]) -> None:
        self._collect = collect
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def begin(self) -> None:
        """Start collecting, if not yet started."""
        if self._thread is None:
            self._ended = threading.Event()
            # A producer that never returns must not keep the program alive.
            self._thread = threading.Thread(
                target=self._run, args=(self._ended,), name="collector", daemon=True
            )
            self._thread.start()

    def end(self) -> None:
        """Stop collecting, and wait until the thread has ended; ending twice does nothing."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self, ended: threading.Event) -> None:
        while not ended.is_set():
            try:
                found = self._collect()
            except CameraError:
                # The next request for a frame raises the same error.
                return
            if not found:
                ended.wait(_POLL_S)
