"""``sgp surface --memory`` that is killed, and continued by the same command."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from acquisition import read_image
from processing import NormalMap, write_normals
from processing.surface import SurfaceStage
from tests.sgp.killed import Server, killed_when, results, server

__all__ = ["server"]

SIZE = (480, 300)
# The least that the command accepts: blocks of a few dozen rows.
MEMORY = f"{SurfaceStage().need(SIZE).least // 10**6 + 1}MB"
KILLS = 10


def steps_done(out: Path) -> dict[str, int]:
    """Return the steps that are complete, and when they were."""
    found = {}
    for path in (out / ".part-surface").glob("step-*.npz"):
        with suppress(FileNotFoundError):
            found[path.name] = path.stat().st_mtime_ns
    return found


@pytest.mark.slow
def test_killed_at_random_moments(server: Server, tmp_path: Path) -> None:
    """Every file is that of an undisturbed command, and no complete step is repeated."""
    row, x = np.mgrid[: SIZE[0], : SIZE[1]] / 40.0
    slopes = np.dstack([0.4 * np.sin(5 * x), 0.3 * np.cos(6 * row), 0 * x + 1])
    noise = np.random.default_rng(3).normal(0, 0.1, (*SIZE, 3))
    write_normals(tmp_path / "n", NormalMap.from_vectors(slopes + noise, (x - 4) ** 2 < row + 9))
    command = ["surface", str(tmp_path / "n"), "--stl", "--memory", MEMORY, "--out"]
    whole, out = tmp_path / "whole", tmp_path / "out"
    server.start([*command, str(whole)])
    assert server.status() == 0
    record = json.loads((whole / "surface.json").read_text())["metrics"]
    blocks, rounds = record["blocks"], record["block_rounds"]
    assert blocks >= 4
    assert rounds >= 1
    # Plan, large pixels, blocks, and all rounds; the last kills hit the files of the result.
    total = 2 + blocks + rounds * (1 + blocks) + 1
    random = np.random.default_rng(11)
    targets = [0, *np.sort(random.integers(1, total, KILLS - 3)), total, total]
    before: dict[str, int] = {}
    killed, status = 0, -1
    for target in targets:
        status = killed_when(
            server,
            [*command, str(out)],
            lambda target=target: len(steps_done(out)) >= target or (out / "surface.json").exists(),
            random.uniform(0, 0.05),
        )
        if status == 0:
            break  # complete before the signal came
        killed += 1
        done = steps_done(out)
        assert before.items() <= done.items()
        before = done
    if status:
        server.start([*command, str(out)])
        assert server.status() == 0
    assert killed >= KILLS // 2, targets
    assert results(out) == results(whole)
    assert np.isfinite(read_image(out / "height.exr")).any()
    assert not (out / ".part-surface").exists()
