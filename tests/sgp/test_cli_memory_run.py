"""``sgp run --memory``: stages in bands of rows give the files of the whole."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition import read_image
from processing.detail import separation as rows
from processing.recording import pipeline as memory
from processing.stages import Need
from processing.surface import SurfaceStage
from processing.surface.blocks import surface_stage
from sgp import read_record
from sgp.stages import memory_limit as _memory_limit
from sgp.stages import run_stages as _run_stages
from tests.sgp.in_bands import CTRL_C, check_equal, interrupted
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
        (surface_stage, "_FIXED"),
        (surface_stage, "_PROGRAM"),
    ):
        monkeypatch.setattr(module, name, 0)
    for module in (_run_stages, _memory_limit):  # the map is too small for several bands
        monkeypatch.setattr(module, "is_in_bands", lambda memory, need: memory is not None)


@pytest.fixture
def given(recording: Path, tmp_path: Path) -> list[object]:
    lights = tmp_path / "lights.json"
    given = ["run", recording, "--lights", lights, "--method", "ls", "--order", 1, "--w", 2]
    return [*given, "--smooth"]  # the search for jumps needs more memory than the map in one band


def check_close(found: Path, expected: Path) -> None:
    check_equal(found, expected, LOOSE)
    heights = [read_image(folder / "surface" / "height.exr") for folder in (found, expected)]
    np.testing.assert_array_equal(*(np.isnan(height) for height in heights))
    assert np.nanmax(np.abs(heights[0] - heights[1])) < 5e-4 * np.nanmax(np.abs(heights[1]))


@pytest.mark.slow
def test_what_is_complete_is_not_done_again(sgp, given, tmp_path, monkeypatch) -> None:
    """After Ctrl-C in each stage, and with other options, which are refused by name."""
    assert sgp(*given, "--out", tmp_path / "whole").code == 0
    out, written = tmp_path / "out", []
    command = [*given, "--out", out, "--memory", LITTLE]
    for name in ("write_normals_stage", "write_separation", "integrated"):
        monkeypatch.setattr(_run_stages, name, noted(getattr(_run_stages, name), name, written))
    with interrupted(CTRL_C[0], 1):
        assert sgp(*command).code == 130
    assert written == []
    assert (out / "normals" / ".part-normals").is_dir()
    for name in ("write_separation", "integrated", "surface_panels"):
        with interrupted(CTRL_C[0], 0, _run_stages, name):
            assert sgp(*command).code == 130
    line = sgp(*command, "--stl").error_line(2)
    assert "differs in stl: repeat that command" in line
    answer = sgp(*command).ok()
    judged = [read_record(folder / "summary.json").judged for folder in (out, tmp_path / "whole")]
    assert judged[0] == judged[1] is not None
    assert answer.out.splitlines()[-1].startswith("good: ")
    assert written == ["write_normals_stage", "write_separation", "integrated"]
    check_close(out, tmp_path / "whole")
    assert (out / "summary.json").is_file()


def noted(function: Callable, name: str, written: list[str]) -> Callable:
    def call(*words: object, **options: object) -> object:
        written.append(name)
        return function(*words, **options)

    return call


def test_what_cannot_be_done_is_refused_before_any_work(sgp, given, tmp_path) -> None:
    command = [*given, "--out", tmp_path / "out", "--memory"]
    line = sgp(*command, LITTLE, "--glb").error_line(2)
    assert "with --glb, which needs the complete surface: give --memory" in line
    line = sgp(*command, LITTLE, "--semi-calibrated").error_line(2)
    assert "with --semi-calibrated, which needs the complete maps" in line
    assert "give at least --memory" in sgp(*command, "10K").error_line(2)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_near_lights_and_a_surface_from_files(sgp, tmp_path, monkeypatch) -> None:
    """Heights above the working plane are those of the whole, in blocks and as a whole."""
    write_images(tmp_path / "cap", HEIGHT, NORMALS, panel(220.0))
    lights = tmp_path / "lights.json"
    given = ["run", tmp_path / "cap", "--lights", lights, "--pixel-mm", PIXEL_MM, "--w", 2]
    given.append("--smooth")
    assert sgp(*given, "--out", tmp_path / "whole").code == 0
    assert sgp(*given, "--out", tmp_path / "blocks", "--memory", LITTLE).code == 0
    check_close(tmp_path / "blocks", tmp_path / "whole")
    monkeypatch.setattr(SurfaceStage, "need", lambda *_: Need(0, 0, "a surface"))
    assert sgp(*given, "--out", tmp_path / "files", "--memory", LITTLE).code == 0
    check_equal(tmp_path / "files", tmp_path / "whole")
