"""Scene files for tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

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
