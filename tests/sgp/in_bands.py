"""What tests of commands with ``--memory`` have in common."""

from __future__ import annotations

import errno
import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from acquisition.files import BandStore

# What interrupts a command, and the exit code.
CTRL_C = KeyboardInterrupt(), 130
FULL_DISK = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), 3


@contextmanager
def interrupted(
    error: BaseException, after: int, of: Any = BandStore, name: str = "complete"
) -> Iterator[None]:
    """Let a method fail after some calls."""
    method, count = getattr(of, name), itertools.count()

    def stopped(*given: Any, **record: Any) -> Any:
        if next(count) >= after:
            raise error
        return method(*given, **record)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(of, name, stopped)
        yield


def files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.suffix in (".exr", ".png")
    }


def check_equal(found: Path, expected: Path, loose: tuple[str, ...] = ()) -> None:
    """Check that folders have equal files, but for those whose names begin so."""
    left, right = files(found), files(expected)
    assert sorted(left) == sorted(right)
    assert [n for n in left if not n.startswith(loose) and left[n] != right[n]] == []
    assert not [path.name for path in found.rglob(".part-*")]
