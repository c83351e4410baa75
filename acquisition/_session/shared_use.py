"""Open files that several threads use: closing waits for nobody, the last user closes them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from acquisition._errors import StorageError


class SharedUse:
    """Who uses the open files of a session.

    Parameters
    ----------
    folder
        The session, for messages.
    release
        Closes the files. Called once: by `close`, or when the last one who used them then is done.
    """

    def __init__(self, folder: Path, release: Callable[[], None]) -> None:
        self._folder = folder
        self._release = release
        self._lock = threading.Lock()
        self._users = 0
        self._closed = False

    def check_open(self) -> None:
        """Raise StorageError after `close`."""
        if self._closed:
            raise StorageError(f"{self._folder}: is closed; reopen the session to go on")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep the files open meanwhile; raises as `check_open`."""
        with self._lock:
            self.check_open()
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if self._closed and not self._users:
                    self._release()

    def close(self) -> None:
        """Let nobody use the files any more; harmless when repeated."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            if not self._users:
                self._release()
