"""Open files that several threads use: `close` does not wait, the last user closes the files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from acquisition._errors import StorageError
from rig.host import threads


class SharedUse:
    """Counts the users of the open files of a session.

    Parameters
    ----------
    folder
        The session, for messages.
    release
        Closes the files. Called once: by `close`, or by the last user if some were left then.
    """

    def __init__(self, folder: Path, release: Callable[[], None]) -> None:
        self._folder = folder
        self._release = release
        self._lock = threads.Lock()
        self._users = 0
        self._closed = False

    def check_open(self) -> None:
        """Raise StorageError after `close`."""
        if self._closed:
            raise StorageError(f"{self._folder}: is closed; reopen the session to continue")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep the files open inside the block; raises the same error as `check_open`."""
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
        """Refuse further use of the files; harmless if repeated."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            if not self._users:
                self._release()
