"""Recordings in virtual time: the real code, with faults from one seed that are replayable.

``python benchmarks/world.py --help`` shows how to run many of them.
"""

import lazy_loader

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
