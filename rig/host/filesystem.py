"""Changes of files, as `os` has them. Files are read without these functions."""

from __future__ import annotations

import os
from pathlib import Path

# `os` is asked at each call, so that a test may also replace its functions.


def open_file(path: str | Path, flags: int, mode: int = 0o777) -> int:
    """Open a file or folder and return its descriptor; see `os.open`."""
    return os.open(path, flags, mode)


def close(descriptor: int) -> None:
    """Close a descriptor of `open_file`."""
    os.close(descriptor)


def write(descriptor: int, data: bytes | memoryview) -> int:
    """Write at the position of a file; return how many bytes the system has accepted."""
    return os.write(descriptor, data)


def write_at(descriptor: int, data: bytes | memoryview, offset: int) -> int:
    """Write at an offset; return how many bytes the system has accepted."""
    return os.pwrite(descriptor, data, offset)


def fsync(descriptor: int) -> None:
    """Wait until the content of a file, or the names in a folder, are on the disk."""
    os.fsync(descriptor)


def replace(path: str | Path, target: str | Path) -> None:
    """Rename a file; a file of the new name is replaced."""
    os.replace(path, target)


def rename(path: str | Path, target: str | Path) -> None:
    """Rename a file; on Windows, the new name must be free."""
    os.rename(path, target)


def unlink(path: str | Path) -> None:
    """Remove a file or a link."""
    os.unlink(path)


def mkdir(path: str | Path, mode: int = 0o777) -> None:
    """Create a folder."""
    os.mkdir(path, mode)


def rmdir(path: str | Path) -> None:
    """Remove an empty folder."""
    os.rmdir(path)
