"""A rig on a fake bench, without a board or a camera."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from rig import Rig
from tests.acquisition.fake_bench import Bench, rig_on


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def rig(bench: Bench) -> Iterator[Rig]:
    rig = rig_on(bench)
    yield rig
    bench.off_fails = False
    rig.close()
