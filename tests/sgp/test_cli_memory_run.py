"""``sgp run --memory``: stages in bands of rows give the files of the whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition import BandStore, read_image
from processing._blocks import memory as block_memory
from processing._detail import rows
from processing._reconstruction import memory
from sgp import _stored_run, _surface_memory
from tests.sgp.test_cli_memory import files, stop
from tests.sgp.test_cli_near import HEIGHT, NORMALS, PIXEL_MM, panel, write_images

LITTLE = "200K"
# Files that depend on the surface, which differs a little in blocks, or on the clock.
LOOSE = ("surface/", "overview.png", "report.html")


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, so that tiny maps do not fit."""
    for module, name in (
        (memory, "_FIXED"),
        (rows, "_FIXED"),
        (rows, "_MOST_MARGINS"),
        (block_memory, "_FIXED"),
        (_surface_memory, "_PROGRAM"),
    ):
        monkeypatch.setattr(module, name, 0)


@pytest.fixture
def given(recording: Path, tmp_path: Path) -> list[object]:
    lights = tmp_path / "lights.json"
    return ["run", recording, "--lights", lights, "--method", "ls", "--order", 1, "--w", 2]


def check_equal(found: Path, expected: Path) -> None:
    left, right = files(found), files(expected)
    assert sorted(left) == sorted(right)
    assert [n for n in left if not n.startswith(LOOSE) and left[n] != right[n]] == []
    heights = [read_image(folder / "surface" / "height.exr") for folder in (found, expected)]
    np.testing.assert_array_equal(*(np.isnan(height) for height in heights))
    assert np.nanmax(np.abs(heights[0] - heights[1])) < 5e-4 * np.nanmax(np.abs(heights[1]))
    assert not [path.name for path in found.rglob(".part-*")]


def test_bands_give_the_files_and_figures_of_the_whole(sgp, given, tmp_path) -> None:
    whole = sgp(*given, "--out", tmp_path / "whole", "--json")
    assert whole.code == 0, whole.err
    banded = sgp(*given, "--out", tmp_path / "bands", "--memory", LITTLE, "--json")
    assert banded.code == 0, banded.err
    assert "normals in bands of rows, detail in bands of rows" in banded.err
    assert "surface of 48 x 40 pixels: in blocks of" in banded.err
    check_equal(tmp_path / "bands", tmp_path / "whole")
    one, other = (json.loads(answer.out) for answer in (whole, banded))
    for stage in ("normals", "detail"):
        assert other["metrics"][stage] == one["metrics"][stage]
    assert other["outputs"].keys() == one["outputs"].keys()
    assert other["notices"] == one["notices"]
