"""Sizes of memory as text."""

from __future__ import annotations

import math


def size_option(count: int) -> str:
    """Return bytes as an option of memory, rounded up."""
    if count < 2**30:
        return f"{math.ceil(count / 2**20)}M"
    return f"{math.ceil(count / 2**30 * 100) / 100:g}G"
