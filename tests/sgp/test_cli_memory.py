"""``--memory``: maps that are computed in bands of rows are those of the whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from acquisition.files import software_version
from processing.recording import pipeline as memory
from sgp.stages import stored_normals as _stored_normals
from tests.sgp.in_bands import CTRL_C, FULL_DISK, check_equal, interrupted

# For 40 x 48 pixels and 8 lights: bands of 10 rows.
LITTLE = "200K"


@pytest.fixture(autouse=True)
def small_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpreter and libraries count as nothing, so that tiny maps do not fit."""
    monkeypatch.setattr(memory, "_FIXED", 0)


@pytest.fixture
def given(recording: Path, tmp_path: Path) -> list[object]:
    return [recording, "--lights", tmp_path / "lights.json", "--method", "cauchy"]


def test_what_is_complete_is_not_computed_again(sgp, given, tmp_path, bands) -> None:
    """After Ctrl-C, and after a full disk."""
    assert sgp("normals", *given, "--out", tmp_path / "whole").code == 0
    command = ["normals", *given, "--out", tmp_path / "bands", "--memory", LITTLE]
    for error, code in (CTRL_C, FULL_DISK):
        with interrupted(error, 1):
            answer = sgp(*command)
        assert answer.code == code
        assert "free space" in answer.err or code == 130
        assert [path.name for path in (tmp_path / "bands").iterdir()] == [".part-normals"]
    assert len(bands) == 2
    other = sgp(*command[:-1], "199K").code  # the budget is no part of the result
    assert other == 0
    rows = [row for _, band in bands for row in range(band.start, band.stop)]
    assert len(rows) == len(set(rows))
    check_equal(tmp_path / "bands", tmp_path / "whole")


def test_unfinished_maps_of_others_are_refused(sgp, given, tmp_path, monkeypatch) -> None:
    command = ["normals", *given, "--out", tmp_path / "out", "--memory", LITTLE]
    with interrupted(CTRL_C[0], 1):
        assert sgp(*command).code == 130
    with monkeypatch.context() as patched:
        patched.setattr(_stored_normals.acquisition.files, "software_version", lambda: "0.0.1")
        line = sgp(*command).error_line(2)
    assert "differs in software version: " in line
    assert "--force" in line
    other = ["normals", *given[:-1], "ls", "--out", tmp_path / "out", "--memory", LITTLE]
    line = sgp(*other).error_line(2)
    assert "differs in method: " in line
    assert software_version() != "0.0.1"
    assert sgp(*other, "--force").code == 0
    assert sgp("normals", *given[:-1], "ls", "--out", tmp_path / "whole").code == 0
    check_equal(tmp_path / "out", tmp_path / "whole")


def test_a_memory_that_is_too_small_is_refused_at_once(sgp, given, tmp_path, monkeypatch) -> None:
    monkeypatch.undo()
    command = ["normals", *given, "--out", tmp_path / "out"]
    line = sgp(*command, "--memory", "100M").error_line(2)
    assert "--memory 100M is too small for 8 images of 48 x 40 pixels: give at least" in line
    least = line.rsplit(" ", 1)[1]
    assert sgp(*command, "--memory", least, "--channel", "gray").code == 0
    line = sgp(*command, "--memory", "100M", "--semi-calibrated", "--force").error_line(2)
    assert "with --semi-calibrated, which needs the complete maps" in line
    for wrong in ("3", "-1G", "x", "nan"):
        assert "is not a size of memory" in sgp(*command, f"--memory={wrong}").error_line(2)


def test_unfinished_maps_of_another_command_are_kept_with_enough_memory(sgp, recording, tmp_path):
    out = tmp_path / "out"
    (out / ".part-normals").mkdir(parents=True)
    (out / ".part-normals" / "identity.json").write_text('{"method": "other"}')
    (out / "normals.exr").write_text("of that command")
    line = sgp("normals", recording, "--lights", tmp_path / "lights.json", "--out", out)
    assert "unfinished maps of a command that differs in" in line.error_line(2)
    assert (out / "normals.exr").read_text() == "of that command"


def test_enough_memory_later_leaves_no_unfinished_maps(sgp, given, tmp_path) -> None:
    command = ["normals", *given, "--out", tmp_path / "out", "--memory"]
    with interrupted(CTRL_C[0], 1):
        assert sgp(*command, LITTLE).code == 130
    assert sgp(*command, "1G").code == 0
    assert sgp("normals", *given, "--out", tmp_path / "whole").code == 0
    check_equal(tmp_path / "out", tmp_path / "whole")
