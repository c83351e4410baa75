"""``sgp detail ... --memory``: what is computed in bands of rows is what is computed at once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import write_png
from processing import ShapeFilter, write_normal_rows
from processing._detail import rows
from tests.quick_sample import quick
from tests.sgp.in_bands import check_bands, check_continued
from tests.sgp.test_cli_memory import bands, check_equal  # noqa: F401 - a fixture

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


def least(kind: str, order: int, w: int) -> str:
    found = rows.least_memory_of_separation(SIZE, ShapeFilter(kind, order, w))
    return f"{found // 1024 + 9}K"


@pytest.mark.parametrize(
    ("kind", "order", "w"),
    quick(
        [
            ("gaussian", 8, 2),
            ("gaussian", 1, 5),
            ("box", 1, 3),
            ("guided", 1, 4),
            ("bilateral", 1, 3),
        ],
        every=2,
    ),
)
def test_separation_in_bands_is_that_of_the_whole(
    sgp,
    relief,
    tmp_path,
    bands,  # noqa: F811
    kind,
    order,
    w,
) -> None:
    command = ["detail", "separate", relief, "--filter", kind, "--order", order, "--w", w]
    check_bands(sgp, bands, tmp_path, command, least(kind, order, w))


def test_maps_of_other_forms(sgp, relief, tmp_path) -> None:
    """A PNG with alpha, green down, and background."""
    (png := tmp_path / "map.png").write_bytes((relief / "normals.png").read_bytes())
    for name, memory in (("whole", "1G"), ("bands", "400K")):
        command = ("detail", "separate", png, "--green", "down", "--w", 1)
        answer = sgp(*command, "--out", tmp_path / name, "--memory", memory)
        assert answer.code == 0, answer.err
        assert "alpha channel is the mask" in answer.err
    check_equal(tmp_path / "bands", tmp_path / "whole")


def test_an_interrupted_separation_continues(sgp, relief, tmp_path, monkeypatch) -> None:
    command = ["detail", "separate", relief, "--order", 1, "--w", 3]
    done = check_continued(
        sgp, monkeypatch, tmp_path, command, "400K", ".part-detail",
        other=("--green", "down"), reason="green",
    )  # fmt: skip
    assert sum(rows.stop - rows.start for rows in done) == SIZE[0]


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
