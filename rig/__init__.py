"""The bench: LED board, camera, and the rig that records which LED lit each frame."""

import lazy_loader

# Loaded at once: a signal handler needs them, and it must not import.
from rig._ending import end_program as end_program
from rig._ending import resend_signal as resend_signal
from rig._kernel_cache import adapt_numba

# Before the first kernel of any package is decorated.
adapt_numba()

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
