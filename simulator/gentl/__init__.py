"""GenTL producer of the virtual camera, a library for GenICam programs."""

from simulator.gentl._build import CompilerError, build

__all__ = ["CompilerError", "build"]
