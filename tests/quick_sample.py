"""Cases of which only some belong to the quick tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def quick(cases: Iterable[Any], every: int) -> list[Any]:
    """Return all cases; those between every ``every``-th one and the next are marked slow.

    A case is a value, a tuple of the values of several parameters, or a `pytest.param`.
    """
    return [case if at % every == 0 else _slow(case) for at, case in enumerate(cases)]


def _slow(case: Any) -> Any:
    if isinstance(case, type(pytest.param())):
        return pytest.param(*case.values, id=case.id, marks=[*case.marks, pytest.mark.slow])
    values = case if isinstance(case, tuple) else (case,)
    return pytest.param(*values, marks=pytest.mark.slow)
