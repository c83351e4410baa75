"""A GenTL producer of our own: the virtual camera as a library for GenICam programs."""

from simulator.gentl._build import CompilerError, build

__all__ = ["CompilerError", "build"]
