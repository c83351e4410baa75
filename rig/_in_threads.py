"""Loops of compiled kernels, divided among threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

# Ranges for each thread: a thread that is done early takes over work of the others.
_RANGES = 4


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
