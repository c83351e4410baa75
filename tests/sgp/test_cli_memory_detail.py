"""``sgp detail ... --memory``: what is computed in bands of rows is what is computed at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import write_png
from processing.detail import separation as rows
from processing.maps import write_normal_rows
from tests.sgp.in_bands import check_continued

SIZE = (330, 60)


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, so that tiny maps do not fit."""
    monkeypatch.setattr(rows, "_FIXED", 0)
    monkeypatch.setattr(rows, "_MOST_MARGINS", 0)
    monkeypatch.setattr(rows, "_MOST_ROWS", 70)


@pytest.fixture(scope="module")
def relief(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Waves with noise in an ellipse, of which the first and last rows are empty."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float32)
    noise = np.random.default_rng(21).normal(0, 0.1, (2, *SIZE))
    slopes = 0.5 * np.sin(x / 17) + noise[0], 0.4 * np.cos(y / 30) + noise[1]
    mask = ((x - 30) / 29) ** 2 + ((y - 160) / 155) ** 2 < 1
    vectors = np.dstack([*slopes, np.ones(SIZE)])
    vectors *= mask[..., None] / np.linalg.norm(vectors, axis=2, keepdims=True)
    folder = tmp_path_factory.mktemp("relief")
    write_normal_rows(folder, vectors.astype(np.float32), mask)
    return folder


def test_an_interrupted_separation_continues(sgp, relief, tmp_path, monkeypatch) -> None:
    command = ["detail", "separate", relief, "--order", 1, "--w", 3]
    done = check_continued(
        sgp, monkeypatch, tmp_path, command, "400K", ".part-detail",
        other=("--green", "down"), reason="green",
    )  # fmt: skip
    assert sum(rows.stop - rows.start for _, rows in done) == 2 * SIZE[0]


def test_a_memory_that_is_too_small_and_a_file_that_is_no_map(sgp, relief, tmp_path) -> None:
    """The least that works is stated, and it works; nothing is left after an error."""
    out = tmp_path / "out"
    line = sgp("detail", "separate", relief, "--out", out, "--memory", "9K").error_line(2)
    assert f"--memory 9K is too small for a normal map of {SIZE[1]} x {SIZE[0]} pixels" in line
    stated = line.rsplit(" ", 1)[1]
    assert sgp("detail", "separate", relief, "--out", out, "--memory", stated).code == 0
    write_png(tmp_path / "gray.png", np.full((*SIZE, 3), 90, np.uint8))
    other = sgp("detail", "separate", tmp_path / "gray.png", "--out", tmp_path / "o", "--w", 1)
    line = other.error_line(3) if other.code == 3 else other.error_line(other.code)
    banded = sgp(
        "detail", "separate", tmp_path / "gray.png", "--out", tmp_path / "o", "--w", 1,
        "--memory", "400K",
    )  # fmt: skip
    assert banded.error_line(banded.code) == line
    assert not (tmp_path / "o").exists()
