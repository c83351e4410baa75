"""``sgp surface --memory``: blocks of rows give the files of the whole."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition import CameraModel, write_camera, write_exr, write_mask
from acquisition.files.storage import storage_error
from processing import NormalMap, write_normals
from processing.surface.blocks import surface_stage
from processing.surface.blocks.block_files import BlockFiles
from tests.sgp.in_bands import CTRL_C, interrupted

SIZE = (192, 60)
# Blocks of 48 rows.
LITTLE = "1200K"
BROKEN, FULL = (
    storage_error(Path("step.npz"), "write", error)
    for error in (OSError("broken"), OSError(errno.ENOSPC, "no space left"))
)


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, so that tiny maps do not fit."""
    monkeypatch.setattr(surface_stage, "_FIXED", 0)
    monkeypatch.setattr(surface_stage, "_PROGRAM", 0)


@pytest.fixture
def given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[object]:
    monkeypatch.chdir(tmp_path)
    row, x = np.mgrid[: SIZE[0], : SIZE[1]] / 40.0
    slopes = np.dstack([0.4 * np.sin(5 * x), 0.3 * np.cos(6 * row), 0 * x + 1])
    noise = np.radians(1) * np.random.default_rng(2).normal(size=(*SIZE, 3))
    mask = np.hypot(row - 2.4, x - 0.75) < 2.3
    normal_map = NormalMap.from_vectors(slopes + noise, mask)
    write_normals("n", normal_map)
    write_exr("sigma.exr", np.where(mask, 1 + x, np.nan).astype(np.float32))
    write_exr("albedo.exr", (0.2 + 0.1 * x).astype(np.float32))
    write_mask("mask.png", np.pad(np.ones((180, 50), bool), ((6, 6), (5, 5))))
    k = np.array([[150.0, 0, 29.5], [0, 150.0, 95.5], [0, 0, 1]])
    write_camera(Path("camera.json"), CameraModel(k, SIZE[1], SIZE[0], 300.0))
    return ["n", "--mask", "mask.png", "--albedo", "albedo.exr", "--sigma", "sigma.exr", "--stl"]


@pytest.mark.parametrize(
    "option",
    ["--glb", "--obj", "--normal-texture", "--close", "--height-sigma",
     "--triangles 9", "--base 2", "--prior sigma.exr"],
)  # fmt: skip
def test_what_needs_the_complete_surface_is_refused(sgp, given, option) -> None:
    answer = sgp("surface", *given, *option.split(), "--out", "x", "--memory", LITTLE)
    name = option.split()[0]
    assert f"with {name}, which needs the complete surface: give --memory" in answer.error_line(2)
    assert not Path("x").exists()


def test_the_least_memory_works(sgp, given) -> None:
    error = sgp("surface", *given, "--out", "x", "--memory", "100K").error_line(2)
    least = error.rpartition("--memory ")[2]
    assert "give at least" in error
    assert sgp("surface", *given, "--out", "x", "--memory", least).code == 0


def test_what_is_interrupted_is_continued(sgp, given) -> None:
    """Ctrl-C and a full disk between blocks and rounds, with less memory afterwards."""
    command = ["surface", *given, "--out", "x", "--memory"]
    assert sgp(*command[:-2], "whole", "--memory", LITTLE).code == 0
    steps = 0
    for error, code in (CTRL_C, (FULL, 3)):
        with interrupted(error, 3, BlockFiles):
            assert sgp(*command, LITTLE).code == code
        before, steps = steps, len(list(Path("x/.part-surface").glob("step-*")))
        assert steps > before
    # More memory does not change the blocks.
    assert sgp(*command, "1300K").code == 0
    assert not Path("x/.part-surface").exists()
    for path in Path("whole").glob("*.[eps]*"):
        assert path.suffix == ".json" or path.read_bytes() == Path("x", path.name).read_bytes()


@pytest.fixture
def begun(sgp, given) -> list[object]:
    """A command that a damaged disk ended between its blocks."""
    command = ["surface", *given, "--out", "x", "--memory", LITTLE]
    with interrupted(BROKEN, 3, BlockFiles):
        assert sgp(*command).code == 3
    return command


def test_blocks_of_other_inputs_are_refused_by_name(sgp, begun) -> None:
    answer = sgp(*begun, "--camera", "camera.json")
    assert answer.code == 2
    assert "differs in camera: repeat that command" in answer.err
    assert Path("x/.part-surface").exists()
    assert sgp(*begun, "--camera", "camera.json", "--force").code == 0


def test_enough_memory_later_leaves_no_blocks(sgp, begun) -> None:
    assert sgp(*begun[:-1], "1G").code == 0
    assert not Path("x/.part-surface").exists()


def test_blocks_that_were_changed_are_refused_by_name(sgp, begun) -> None:
    part = Path("x/.part-surface/solution-0-0.raw")
    part.write_bytes(bytes(part.stat().st_size))
    answer = sgp(*begun)
    text = f"{part}: was changed since it was computed: add --force to begin again"
    assert (answer.code, text in answer.err) == (2, True)
    assert sgp(*begun, "--force").code == 0
    assert not Path("x/.part-surface").exists()


def test_inputs_without_a_surface_leave_nothing(sgp, given) -> None:
    write_mask("mask.png", np.eye(*SIZE, dtype=bool))
    answer = sgp("surface", *given, "--out", "x", "--memory", LITTLE)
    assert answer.code == 5
    assert "no two neighbouring pixels" in answer.err
    assert not Path("x").exists()


def test_a_disk_that_is_too_small_is_refused_at_once(sgp, given, monkeypatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1_000_000))
    answer = sgp("surface", *given, "--out", "x", "--memory", LITTLE)
    assert answer.code == 3
    assert "of disk while it is computed, 977K are free" in answer.err
    assert not Path("x").exists()
