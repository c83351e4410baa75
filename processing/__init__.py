"""From linear images to normals, shape, detail and geometry."""

import lazy_loader

import rig as _rig  # noqa: F401 - adapts the cache of the kernels

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
