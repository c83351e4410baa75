"""A thread that takes frames out of a camera's buffers while the program is busy otherwise."""

from __future__ import annotations

import threading
from collections.abc import Callable

from rig._errors import CameraError

_POLL_S = 0.001


class Collector:
    """Does nothing but collect, from `begin` to `end`.

    Parameters
    ----------
    collect
        Takes one frame and returns True; False where there is none, or no room, at this moment.
    """

    def __init__(self, collect: Callable[[], bool]) -> None:
        self._collect = collect
        self._thread: threading.Thread | None = None
        self._ended = threading.Event()

    def begin(self) -> None:
        """Start collecting, unless it has been started."""
        if self._thread is None:
            self._ended = threading.Event()
            # A producer that never returns must not keep the program alive.
            self._thread = threading.Thread(
                target=self._run, args=(self._ended,), name="collector", daemon=True
            )
            self._thread.start()

    def end(self) -> None:
        """Stop collecting, and wait until nothing is under way; ending twice does nothing."""
        self._ended.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self, ended: threading.Event) -> None:
        while not ended.is_set():
            try:
                found = self._collect()
            except CameraError:
                # Whoever asks for the next frame meets the same error.
                return
            if not found:
                ended.wait(_POLL_S)
