"""Scene files and a board for tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.simulator.desk import Desk

# The lens of a small scene.
SMALL = "[lens]\nkind = 'perspective'\nwidth = 48\nheight = 40\n"


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str], Path]:
    """Write a scene file, and return its path."""

    def write(text: str) -> Path:
        path = tmp_path / "scene.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path / "bench.state")
    yield desk
    desk.close()
