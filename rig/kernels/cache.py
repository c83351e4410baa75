"""The cache of compiled kernels, and what is done where they cannot be kept.

numba keeps them next to the program, or else in the user's cache; without both it refuses to
compile. As soon as numba is loaded, the kernels of this project get a cache that has a third place,
a folder of the user among the temporary files, and that never ends the work: a kernel that cannot
be kept or read back is compiled. A version of numba that is built in another way keeps its own
behaviour.

NUMBA_CACHE_DIR would move the kernels of other packages, too, and has no third place; a wrapper
around `njit` could be forgotten.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any, Final

# The module of numba that chooses the cache of a function when it is decorated.
_DISPATCHER: Final = "numba.core.dispatcher"
_PACKAGES: Final = ("rig", "acquisition", "calibration", "processing", "simulator", "sgp")


def adapt_numba() -> None:
    """Give the kernels of this project their cache, now or as soon as numba is loaded."""
    if _DISPATCHER in sys.modules:
        _adapt(sys.modules[_DISPATCHER])
    else:
        sys.meta_path.insert(0, _Finder())


def kernel_folder() -> Path | None:
    """Return the folder of the kernels of this package, None if kernels cannot be kept.

    Examples
    --------
    >>> from rig.kernels import kernel_folder
    >>> kernel_folder() is None
    False
    """
    dispatcher = importlib.import_module(_DISPATCHER)
    # RuntimeError: numba's own cache finds no place. AttributeError: it is built in another way.
    with suppress(RuntimeError, AttributeError):
        path = dispatcher.FunctionCache(kernel_folder).cache_path
        return None if path is None else Path(path)
    return None


class _Finder:
    """Finds the module of numba as usual, and adapts it when it has been loaded."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if name != _DISPATCHER:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_adapt(module: ModuleType) -> None:
                load(module)
                _adapt(module)

            with suppress(AttributeError):  # a loader with slots
                spec.loader.exec_module = load_and_adapt  # type: ignore[method-assign]
        return spec


def _adapt(dispatcher: ModuleType) -> None:
    with suppress(Exception):  # whatever another version of numba does not have
        from rig.kernels.numba_cache import cache_of, count_compilations

        usual = dispatcher.FunctionCache

        def cache(function: Callable[..., object], *others: Any, **named: Any) -> Any:
            if function.__module__.partition(".")[0] in _PACKAGES:
                with suppress(Exception):
                    return cache_of(function)
            return usual(function, *others, **named)

        count_compilations()
        dispatcher.FunctionCache = cache  # type: ignore[attr-defined]
