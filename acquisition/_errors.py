"""What can go wrong with data. Every message says what, where and what to do, in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rig import UnreadableError


class MissingPathError(FileNotFoundError):
    """A path that was named does not exist (exit code 2 at the front door)."""


class StorageError(OSError):
    """The disk under a capture refused a write (exit code 3 at the front door)."""


class SessionInUseError(StorageError):
    """Another process is writing to the session."""


class DataError(ValueError):
    """An input or session is damaged, incomplete, inconsistent or not understood (exit code 4)."""


@contextmanager
def declared(path: Path) -> Iterator[None]:
    """Turn what the guard of the readers says of a file into the errors that readers declare.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If the guard refuses it; the message names the file.
    """
    try:
        yield
    except MissingPathError:
        raise
    except FileNotFoundError as error:
        raise MissingPathError(f"{path}: no such file") from error
    except UnreadableError as error:
        raise DataError(f"{path}: {error}") from error
