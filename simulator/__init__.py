"""Simulated rig: scenes, renderer, sensor, virtual LED board and virtual camera.

Modules are imported when one of their names is first used: the process of the virtual board does
not need the renderer and starts in a fraction of the time.
"""

import lazy_loader

import rig as _rig  # noqa: F401 - adapts the cache of the kernels

# The names are listed in __init__.pyi.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
