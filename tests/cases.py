"""Cases of a test as a table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest


def cases(names: str | tuple[str, ...], table: Mapping[str, Any]) -> pytest.MarkDecorator:
    """Run a test for each row of a table: by the name of the case, the values of the arguments."""
    return pytest.mark.parametrize(names, list(table.values()), ids=list(table))
