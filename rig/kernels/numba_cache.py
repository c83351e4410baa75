"""The cache of compiled kernels: numba's files, checked when they are read back."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba.core import config as _config
from numba.core import event
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache

from rig.kernels.threads import private_folder, state_compiling, state_uncached

config: Any = _config
_DIGEST = hashlib.sha256().digest_size


def cache_of(function: Callable[..., object]) -> Any:
    """Return the cache of a kernel: in numba's usual places, a private folder, or none."""
    with contextlib.suppress(RuntimeError):  # no usual place can be written
        return _KernelCache(function)
    usual = config.CACHE_DIR
    folder = private_folder()
    if folder is not None:
        config.CACHE_DIR = str(folder)
        try:
            return _KernelCache(function)
        except RuntimeError:
            pass
        finally:
            config.CACHE_DIR = usual
    state_uncached("no folder for them can be written")
    return NullCache()


def count_compilations() -> None:
    """Report from now on how many kernels are being compiled, and compile without the collector."""
    event.register("numba:compile", _Compilations())


class _CheckedFiles(IndexDataCacheFile):
    """Files that end with their SHA-256: damaged machine code could do anything."""

    def _dump(self, obj: object) -> bytes:
        data: bytes = super()._dump(obj)
        return data + hashlib.sha256(data).digest()

    def _load_data(self, name: str) -> Any:
        data = Path(self._data_path(name)).read_bytes()
        data, digest = data[:-_DIGEST], data[-_DIGEST:]
        if hashlib.sha256(data).digest() != digest:
            raise ValueError(f"{name} is damaged")
        return pickle.loads(data)


class _KernelCache(FunctionCache):
    """A cache that never ends the work."""

    def __init__(self, function: Callable[..., object]) -> None:
        super().__init__(function)
        self._cache_file = _CheckedFiles(
            cache_path=self.cache_path,
            filename_base=self._impl.filename_base,
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, signature: Any, target: Any) -> Any:
        """Return a kernel that was kept, or None; files that cannot be used are given up."""
        try:
            return super().load_overload(signature, target)
        except Exception:  # noqa: BLE001 - damaged files cause any error
            try:
                self.flush()
            except OSError:
                self.disable()
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep a kernel; without room for it, it is compiled again in the next run."""
        try:
            super().save_overload(signature, compiled)
        except Exception as error:  # noqa: BLE001 - the kernel is there, and works without a file
            self.disable()
            reason = getattr(error, "strerror", None) or type(error).__name__
            state_uncached(f"{self.cache_path} cannot be written ({reason})")


class _Compilations(event.Listener):
    """Compilations that have begun, each within another.

    The garbage collector rests meanwhile: numba makes many objects, but few cycles, and a search
    through all objects of the program each time takes a fifth of the time.
    """

    def __init__(self) -> None:
        self._active = 0
        self._collects = False

    def on_start(self, _: event.Event) -> None:
        if not self._active:
            self._collects = gc.isenabled()
            gc.disable()
        self._active += 1
        state_compiling(self._active)

    def on_end(self, _: event.Event) -> None:
        self._active -= 1
        if not self._active and self._collects:
            gc.enable()
        state_compiling(self._active)
