"""Functions of single pixels are compiled without counting references, and stay safe without it."""

from __future__ import annotations

import sys
from typing import Any

import numba
import numpy as np
import pytest

from processing.stereo.pixel_algebra import IN_PLACE


def of_a_slice(values: Any, row: int, below: int) -> Any:
    part = values[row, 1:]
    return part[0] // below


def allocated(count: int) -> Any:
    return np.zeros(count).sum()


def test_the_pinned_numba_counts_no_references_in_functions_of_single_pixels() -> None:
    values = np.arange(6).reshape(2, 3)
    found = []
    for options in ({}, IN_PLACE):
        compiled = numba.njit(**options)(of_a_slice)
        assert compiled(values, 1, 2) == 2
        found.append("".join(compiled.inspect_llvm().values()).count("call void @NRT_"))
    assert found[1] < found[0], (
        f"numba {numba.__version__} ignores or lacks the option _nrt of IN_PLACE in "
        "processing/stereo/pixel_algebra.py: estimators and error bars take 10 to 50 % longer. "
        "Find its new name, or remove IN_PLACE"
    )
    # An exception inside passes through, and leaves no reference behind.
    before = sys.getrefcount(values)
    for _ in range(3):
        with pytest.raises(ZeroDivisionError):
            compiled(values, 0, 0)
    assert sys.getrefcount(values) == before


def test_a_function_that_allocates_is_refused() -> None:
    with pytest.raises(numba.core.errors.TypingError, match="array passed into the function"):
        numba.njit(**IN_PLACE)(allocated)(3)
