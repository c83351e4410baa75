"""Shots: one LED, one exposure, one frame, and the proof that they belong together."""

import lazy_loader

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
