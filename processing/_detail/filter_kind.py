"""The names of the shape filters."""

from __future__ import annotations

from typing import Literal, get_args

FilterKind = Literal["gaussian", "box", "guided", "bilateral"]
FILTER_KINDS: tuple[FilterKind, ...] = get_args(FilterKind)
