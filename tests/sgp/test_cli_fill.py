"""``sgp detail fill``: files, record, notices, and one line for bad input."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquisition import read_image, write_mask
from processing import read_normals, write_normals
from tests.processing.scenes import folds


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with normals of waves, and masks of holes."""
    folder = tmp_path_factory.mktemp("fill")
    write_normals(folder / "waves", folds((70, 80), 2.5, np.s_[:, :10]))
    for name, window in {
        "hole": (slice(30, 45), slice(40, 55)),
        "beyond": (slice(30, 45), slice(5, 20)),
        "all": (slice(None), slice(None)),
    }.items():
        holes = np.zeros((70, 80), np.bool_)
        holes[window] = True
        write_mask(folder / f"{name}.png", holes)
    write_mask(folder / "small.png", np.ones((7, 8), np.bool_))
    return folder


def test_a_filled_map_with_its_record(sgp, maps: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("detail", "fill", maps / "waves", "--holes", maps / "hole.png", "--out", out)
    answer = sgp(*words, "--patch", 12, "--json").ok()
    holes = read_image(maps / "hole.png")
    np.testing.assert_array_equal(read_image(out / "invented.png"), holes)
    filled = read_normals(out / "normals.exr").normal_map
    given = read_normals(maps / "waves").normal_map
    np.testing.assert_array_equal(filled.normals[holes == 0], given.normals[holes == 0])
    record = json.loads((out / "fill.json").read_text(encoding="utf-8"))
    assert record["parameters"]["patch"] == 12
    assert any(name.endswith("hole.png") for name in record["inputs"])
    assert record["metrics"]["filled_pixels"] == 15 * 15
    assert record["metrics"]["seam_ratio"] < 2.5
    assert (out / "fill.png").is_file()
    assert json.loads(answer.out)["notices"] == []


def test_holes_outside_the_object_are_reported(sgp, maps: Path, tmp_path: Path) -> None:
    words = ("detail", "fill", maps / "waves", "--holes", maps / "beyond.png", "--patch", 12)
    assert "75 pixels of the holes had no normal" in sgp(*words, "--out", tmp_path / "out").ok().err
    assert read_normals(tmp_path / "out").normal_map.mask[30:45, 5:20].all()


@pytest.mark.parametrize(
    ("holes", "options", "code", "text"),
    [
        pytest.param("small", [], 4, "8 x 7", id="other size"),
        pytest.param("all", [], 4, "covers every normal", id="all"),
        pytest.param("none", [], 2, "none.png", id="missing"),
        pytest.param("hole", ["--patch", 60], 4, "no patch of 60 x 60", id="patch"),
        pytest.param("hole", ["--overlap", 9], 4, "overlap", id="overlap"),
    ],
)
def test_bad_options(sgp, maps: Path, tmp_path: Path, holes, options, code: int, text: str) -> None:
    words = ("detail", "fill", maps / "waves", "--holes", maps / f"{holes}.png", *options)
    answer = sgp(*words, "--out", tmp_path / "out")
    assert answer.code == code, answer.err
    assert text in answer.err
    assert len(answer.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
