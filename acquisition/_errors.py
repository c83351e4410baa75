"""Errors about data. Every message says in one line what is wrong, where, and what to do."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rig import Notice, RigError, SgpError, UnreadableError


class MissingPathError(SgpError, FileNotFoundError):
    """A path that the caller named does not exist (exit code 2 of the commands)."""


class StorageError(SgpError, OSError):
    """The disk refused a write (exit code 3 of the commands)."""


class SessionInUseError(StorageError):
    """Another process is writing to the session."""


class DataError(SgpError, ValueError):
    """An input or session is damaged, incomplete, inconsistent or unknown (exit code 4)."""


class NotAcceptedError(RigError):
    """A finding that makes a recording useless was not accepted.

    Parameters
    ----------
    finding
        The finding.
    """

    def __init__(self, finding: Notice) -> None:
        super().__init__(str(finding))
        self.finding = finding


def missing_path(path: Path, kind: str = "file or folder") -> MissingPathError:
    """Return the error for a path that does not exist; a link that leads nowhere is named as one.

    Examples
    --------
    >>> from pathlib import Path
    >>> from acquisition import missing_path
    >>> str(missing_path(Path("owl.png"), "file"))
    'owl.png: no such file'
    >>> Path("owl.png").symlink_to("lost.png")
    >>> str(missing_path(Path("owl.png")))
    'owl.png: a link to lost.png, which is not there: restore it, or correct the link'
    """
    if not path.is_symlink():
        return MissingPathError(f"{path}: no such {kind}")
    return MissingPathError(
        f"{path}: a link to {os.readlink(path)}, which is not there: restore it, or correct the "
        "link"
    )


@contextmanager
def convert_read_errors(path: Path) -> Iterator[None]:
    """Turn the errors of the bounded readers into those that file readers declare.

    Raises
    ------
    MissingPathError
        If there is no such file.
    DataError
        If the bounded reader refuses it; the message names the file.
    """
    try:
        yield
    except UnreadableError as error:
        raise DataError(f"{path}: {error}") from error
    except SgpError:
        raise
    except FileNotFoundError as error:
        raise missing_path(path, "file") from error


@contextmanager
def named(where: object) -> Iterator[None]:
    """Begin the message of a DataError with the file or the part that it is about."""
    try:
        yield
    except DataError as error:
        raise DataError(f"{where}: {error}") from error
