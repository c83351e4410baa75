"""What is done for kernels without numba: a folder that no other user can write, and reports."""

from __future__ import annotations

import os
import stat
import warnings
from pathlib import Path
from typing import Final

_REMEDY: Final = "set NUMBA_CACHE_DIR to a folder that can be written"


def private_folder() -> Path | None:
    """Return a private folder among the temporary files; None if no safe one can be made.

    A kernel that is read back is code: a folder that another user has made, or can write or
    replace, is not used.

    Examples
    --------
    >>> from rig import private_folder
    >>> folder = private_folder()
    >>> folder is None or folder.is_dir()
    True
    """
    if not hasattr(os, "geteuid"):  # Windows keeps temporary files with those of the user
        return None
    for place in (os.environ.get("TMPDIR"), "/tmp", "/var/tmp"):
        if (
            place
            and os.path.isabs(place)
            and _is_private(path := Path(place) / f"sgp-{os.geteuid()}")
        ):
            return path
    return None


def _is_private(folder: Path) -> bool:
    try:
        above = folder.parent.stat()
        if above.st_mode & stat.S_IWOTH and not above.st_mode & stat.S_ISVTX:
            return False
        folder.mkdir(0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return False
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    return ours and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


class KernelWatch:
    """What happens to kernels in this process; a program that reports it replaces the methods.

    Examples
    --------
    >>> from rig import KernelWatch
    >>> KernelWatch().compiling(1)
    """

    def compiling(self, active: int) -> None:
        """Report how many kernels are being compiled, each within another, when that changes."""

    def uncached(self, reason: str) -> None:
        """Report that kernels cannot be kept, at most once; the default warns."""
        warnings.warn(reason, RuntimeWarning, stacklevel=1)


class _State:
    watch = KernelWatch()
    stated = False


def watch_kernels(watch: KernelWatch) -> None:
    """Set who is informed about kernels that are compiled, and those that cannot be kept.

    Examples
    --------
    >>> from rig import KernelWatch, watch_kernels
    >>> watch_kernels(KernelWatch())
    """
    _State.watch = watch


def state_uncached(reason: str) -> None:
    """State once that kernels cannot be kept, and what to do."""
    if not _State.stated:
        _State.stated = True
        _State.watch.uncached(f"kernels are compiled in every run, because {reason}: {_REMEDY}")


def state_compiling(active: int) -> None:
    """Report how many kernels are being compiled."""
    _State.watch.compiling(active)
