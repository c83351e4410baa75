"""Compiled kernels: their private folder, who is informed about them, and loops in threads."""

from __future__ import annotations

import os
import stat
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

_REMEDY: Final = "set NUMBA_CACHE_DIR to a folder that can be written"
# Ranges for each thread: a thread that is done early takes over work of the others.
_RANGES = 4


def private_folder() -> Path | None:
    """Return a private folder among the temporary files; None if no safe one can be made.

    A kernel that is read back is code: a folder that another user has made, or can write or
    replace, is not used.

    Examples
    --------
    >>> from rig.kernels import private_folder
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
    >>> from rig.kernels import KernelWatch
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
    >>> from rig.kernels import KernelWatch, watch_kernels
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


def in_threads(kernel: Callable[..., object], count: int, *arguments: Any) -> None:
    """Call ``kernel(first, last, *arguments)`` for ranges that together are ``range(count)``.

    The kernel is compiled with ``nogil=True`` instead of ``parallel=True``, which takes three to
    six times as long to compile. The number of threads is that of `numba.get_num_threads`. It has
    no effect on the result of a kernel whose iterations are independent.

    Parameters
    ----------
    kernel
        A function compiled by numba. What it returns is ignored.
    count
        The number of iterations, 0 or more.
    arguments
        What the kernel receives after the limits of a range, for instance arrays that it fills.

    Raises
    ------
    Exception
        The first error of the kernel, after all threads have ended.

    Examples
    --------
    >>> import numba, numpy as np
    >>> from rig import in_threads
    >>> @numba.njit(nogil=True)
    ... def square(first, last, values):
    ...     for i in range(first, last):
    ...         values[i] *= values[i]
    >>> values = np.arange(5.0)
    >>> in_threads(square, len(values), values)
    >>> values.tolist()
    [0.0, 1.0, 4.0, 9.0, 16.0]
    """
    # Imported here: a program that only watches kernels needs neither.
    from concurrent.futures import ThreadPoolExecutor

    import numba

    threads = min(numba.get_num_threads(), count)
    if threads <= 1:
        kernel(0, count, *arguments)
        return
    # Compiles the kernel, if necessary, in this thread: here a signal waits for the compiler.
    kernel(0, 0, *arguments)
    pieces = min(_RANGES * threads, count)

    def solve(piece: int) -> None:
        kernel(count * piece // pieces, count * (piece + 1) // pieces, *arguments)

    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(solve, range(pieces)):
            pass
