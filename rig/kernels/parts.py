"""Options of `numba.njit` for functions that only compiled kernels call."""

from __future__ import annotations

from typing import Any, Final

# A part of a kernel: its machine code is kept with that of the kernel.
PART: Final[dict[str, Any]] = {"no_cfunc_wrapper": True}
# A part whose sums may be evaluated in another order (`fastmath`), or that contains such a part. It
# must not have machine code of its own: the linker would choose one of several copies, which
# differ in rounding, and results would depend on which kernels were loaded before.
INLINED: Final[dict[str, Any]] = {**PART, "forceinline": True}
