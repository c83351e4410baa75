"""The files that a program reads, each with its status when it was first opened.

Every reader of files of others states here what it has opened, so that a command can find out at
its end whether an input is still the file that it used.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, Self


class FileStatus(NamedTuple):
    """What differs if a file was replaced or changed, even if its time was set back.

    Parameters
    ----------
    device, inode
        Identity of the file; a file that replaces it has another one.
    size
        Bytes.
    mtime_ns, ctime_ns
        Times of the last change of the content and of the file itself, in ns.
    """

    device: int
    inode: int
    size: int
    mtime_ns: int
    ctime_ns: int

    @classmethod
    def of(cls, status: os.stat_result) -> Self:
        """Return the part of a status that a reading does not change."""
        times = status.st_mtime_ns, status.st_ctime_ns
        return cls(status.st_dev, status.st_ino, status.st_size, *times)


_read: dict[Path, FileStatus] | None = None


@contextmanager
def files_read() -> Iterator[Mapping[Path, FileStatus]]:
    """Collect the files that are read in the block, by all threads of this process.

    Yields
    ------
    Mapping[Path, FileStatus]
        The status of each file when it was first opened, by its absolute path.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import files_read, read_bounded
    >>> _ = Path("notes.txt").write_text("owl")
    >>> with files_read() as found:
    ...     _ = read_bounded(Path("notes.txt"))
    >>> [(path.name, status.size) for path, status in found.items()]
    [('notes.txt', 3)]
    """
    global _read  # readers have no other way to reach the command that they work for
    before, _read = _read, {}
    try:
        yield _read
    finally:
        _read = before


def note_read(path: Path, descriptor: int) -> os.stat_result:
    """Return the status of an open file, which is kept if it is the first one inside `files_read`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import note_read
    >>> _ = Path("notes.txt").write_text("owl")
    >>> with Path("notes.txt").open("rb") as file:
    ...     note_read(Path("notes.txt"), file.fileno()).st_size
    3
    """
    status = os.fstat(descriptor)
    if _read is not None:
        _read.setdefault(Path(os.path.abspath(path)), FileStatus.of(status))
    return status


def status_when_read(path: Path) -> FileStatus | None:
    """Return the status that a file had when it was first opened; None if it was not noted.

    Examples
    --------
    >>> from pathlib import Path
    >>> from rig import status_when_read
    >>> status_when_read(Path("notes.txt")) is None
    True
    """
    return None if _read is None else _read.get(Path(os.path.abspath(path)))
