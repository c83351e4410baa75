"""How copies of a source that is smaller than its target are joined."""

from __future__ import annotations

from typing import Literal, get_args

Tile = Literal["cut", "mirror", "plain"]
TILES: tuple[Tile, ...] = get_args(Tile)
