"""A rig made of numbers: scenes, renderer, sensor, virtual LED board and virtual camera.

All of it is loaded when a name is first asked for: the process of the virtual board needs none of
the renderer, and starts in a fraction of the time.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simulator import _public
    from simulator._public import *  # noqa: F403

    __all__ = _public.__all__
else:

    def __getattr__(name: str) -> object:
        # Asked for while _public itself is loading: a module of that name, or nothing.
        if name.startswith("_"):
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module("simulator._public"), name)
