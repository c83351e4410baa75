"""A rig on a fake bench, without a board or a camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from rig import Rig
from tests.acquisition.fake_bench import Bench, rig_on


@pytest.fixture(scope="session", autouse=True)
def _quick_starts(quick_starts: None) -> None:
    """Fork the boards and cameras; tests/simulator starts them as programs do."""


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def rig(bench: Bench) -> Iterator[Rig]:
    rig = rig_on(bench)
    yield rig
    bench.off_fails = False
    rig.close()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder for the images of a camera."""
    (tmp_path / "in").mkdir()
    return tmp_path / "in"


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder for a session, which does not exist."""
    return tmp_path / "out"


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    """A file outside, which nothing may change."""
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "victim").write_bytes(b"mine")
    return folder / "victim"
