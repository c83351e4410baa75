"""``sgp detail superres --memory``: bands of rows give the files and figures of the whole."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from acquisition.files import BandStore
from processing import NormalMap, write_normals
from processing.superres import SuperResolutionStage
from processing.superres import higher_resolution as memory
from tests.sgp.test_cli_memory import check_equal, stop

SIZE = (95, 13)


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, so that tiny maps do not fit; small tiles."""
    monkeypatch.setattr(memory, "_FIXED", 0)
    monkeypatch.setattr(memory, "TILE_PX", 16)


@pytest.fixture(scope="module")
def low(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rough waves with a hole."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    noise = np.random.default_rng(907).normal(0, 0.2, (2, *SIZE))
    slopes = np.sin(x / 3) * 0.4 + noise[0], np.cos(y / 5) * 0.3 + noise[1]
    mask = ~((abs(x - 5) < 2) & (abs(y - 40) < 9))
    folder = tmp_path_factory.mktemp("low")
    write_normals(folder, NormalMap.from_vectors(np.dstack([*slopes, np.ones(SIZE)]), mask))
    return folder


def least(scale: int) -> str:
    return f"{SuperResolutionStage.of(scale).need(SIZE).least // 1024 + 1}K"


@pytest.mark.slow
def test_an_interrupted_enlargement_continues(sgp, low, tmp_path, monkeypatch) -> None:
    """After a full disk and Ctrl-C, also with more memory; what is complete is not done again."""
    command = ["detail", "superres", low, "--scale", 4, "--method", "bicubic", "--out"]
    out, limit = tmp_path / "out", ["--memory", least(4)]
    done: list[tuple[str, int]] = []
    complete = BandStore.complete

    def noted(store: BandStore, step: str, rows: slice) -> None:
        complete(store, step, rows)
        done.append((step, rows.start))

    monkeypatch.setattr(BandStore, "complete", noted)
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    for error, code in ((full, 3), (KeyboardInterrupt(), 130)):
        with monkeypatch.context() as patched:
            patched.setattr(BandStore, "complete", stop(error, 1))
            assert sgp(*command, out, *limit).code == code
        assert [path.name for path in out.iterdir()] == [".part-superres"]
    assert len(done) == 2
    other = ["detail", "superres", low, "--scale", 2, "--method", "bicubic", "--out", out]
    assert "differs in scale, maps: repeat that" in sgp(*other, "--memory", least(2)).error_line(2)
    assert sgp(*command, out, "--memory", "1G").code == 0
    assert len(done) == len(set(done)) > 2
    assert sgp(*command, tmp_path / "whole").code == 0
    check_equal(out, tmp_path / "whole")


@pytest.mark.slow
def test_a_memory_that_is_too_small_and_a_map_that_is_read_at_once(sgp, low, tmp_path) -> None:
    """The least that works is stated."""
    out = tmp_path / "out"
    line = sgp("detail", "superres", low, "--scale", 4, "--out", out, "--memory", "9K").error_line(
        2
    )
    expected = f"too small for a normal map of {SIZE[1]} x {SIZE[0]} pixels at scale 4: give at"
    assert expected in line
    np.save(tmp_path / "low.npy", np.tile(np.float32([0, 0, 1]), (*SIZE, 1)))
    command = ("detail", "superres", tmp_path / "low.npy", "--scale", 4, "--out", out)
    line = sgp(*command, "--memory", least(4)).error_line(4)
    assert "save it as .exr" in line
    assert not out.exists()
