"""Roughness: form, filters, and parameters of areas and profiles with their uncertainty."""

import lazy_loader

# The names are listed in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
