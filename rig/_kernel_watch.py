"""Who is informed about kernels that are compiled, and those that cannot be kept."""

from __future__ import annotations

import warnings
from typing import Final

_REMEDY: Final = "set NUMBA_CACHE_DIR to a folder that can be written"


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
