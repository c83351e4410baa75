"""Cases of which only some belong to the quick tests."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def quick(cases: Iterable[Any], every: int) -> list[Any]:
    """Return all cases; those between every ``every``-th one and the next are marked slow.

    A case is a value, or a tuple of the values of several parameters.
    """
    return [
        case if at % every == 0 else pytest.param(*_values(case), marks=pytest.mark.slow)
        for at, case in enumerate(cases)
    ]


def _values(case: Any) -> tuple[Any, ...]:
    return case if isinstance(case, tuple) else (case,)
