"""The names of the shape filters, and of the ways to join copies of a source."""

from __future__ import annotations

from typing import Literal, get_args

FilterKind = Literal["gaussian", "box", "guided", "bilateral"]
FILTER_KINDS: tuple[FilterKind, ...] = get_args(FilterKind)

# How copies of a source that is smaller than its target are joined.
Tile = Literal["cut", "mirror", "plain"]
TILES: tuple[Tile, ...] = get_args(Tile)
