"""A rig made of numbers: scenes, renderer, sensor, virtual LED board and virtual camera.

All of it is loaded when a name is first asked for: the process of the virtual board needs none of
the renderer, and starts in a fraction of the time.
"""

import lazy_loader

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
