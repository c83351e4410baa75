"""The bench: LED board, camera, and the rig that records which LED lit each frame."""

import lazy_loader

from rig.kernels.cache import adapt_numba

# Loaded at once: a signal handler needs them, and it must not import.
from rig.processes.ending import end_program as end_program
from rig.processes.ending import resend_signal as resend_signal

# Before the first kernel of any package is decorated.
adapt_numba()

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
