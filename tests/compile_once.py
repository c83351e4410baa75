"""Workers of a test run do not compile the same kernel at the same time.

The first tests of all workers need the same kernels. Until one worker has saved a kernel in numba's
cache, each compiles it, and two that save versions of it at the same time may exchange them.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]


def one_by_one(compiler: Callable[[Any, Any], Any], folder: Path) -> Callable[[Any, Any], Any]:
    """Return ``Dispatcher.compile`` that waits while another process with this folder is in it.

    A process that waited finds the kernel in the cache, where ``Dispatcher.compile`` looks first.
    """
    from numba.core.compiler_lock import global_compiler_lock

    active: set[str] = set()

    @functools.wraps(compiler)
    def compile_alone(kernel: Any, signature: Any) -> Any:
        name = f"{kernel.py_func.__module__}.{kernel.py_func.__name__}"
        # Threads wait first: one that waits here could hold a file that the other needs.
        with global_compiler_lock:
            # Kernels call no kernels in a circle, so processes cannot wait for each other. A
            # function of numba, without a cache, could.
            if name in active or kernel.stats.cache_path is None:
                return compiler(kernel, signature)
            active.add(name)
            try:
                with alone(folder / name):
                    return compiler(kernel, signature)
            finally:
                active.remove(name)

    return compile_alone


@contextmanager
def alone(file: Path) -> Iterator[None]:
    """Wait until no other process is in this block with the same file."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(file, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
