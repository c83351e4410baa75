"""What the rig and the recordings take from the operating system: time, threads, files, signals.

Production calls the operating system directly. A test may replace the functions of these modules,
as `simulator.world` does, to run the same code in virtual time.
"""

import lazy_loader

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
