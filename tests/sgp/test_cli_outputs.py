"""Allowed places of results, their records, and errors in JSON."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from acquisition import write_exr
from processing import NormalMap
from rig import BoardError
from sgp.app import build, run
from sgp.cli.exit import UsageError
from sgp.results import Result, claim_folder, read_record, writes_folder


@pytest.fixture
def words(recording):
    return ("normals", recording, "--lights", recording.parent / "lights.json")


def test_a_record_contains_parameters_inputs_and_outputs(sgp, words, recording, tmp_path):
    out = tmp_path / "out"
    assert sgp(*words, "--method", "ls", "--out", out).code == 0
    record = json.loads((out / "normals.json").read_text(encoding="utf-8"))
    assert record["command"] == "sgp normals"
    assert record["parameters"]["method"] == "ls"
    assert record["outputs"]["normals"] == "normals.exr"
    assert len(record["inputs"][str(recording / "ball.3.png")]) == 64
    assert str(tmp_path / "lights.json") in record["inputs"]


def test_every_stage_of_run_leaves_its_record(sgp, words, tmp_path):
    out = tmp_path / "out"
    assert sgp("run", *words[1:], "--out", out).code == 0
    for name in ("normals", "detail", "surface"):
        assert json.loads((out / name / f"{name}.json").read_text(encoding="utf-8"))["metrics"]


def test_a_failed_run_leaves_nothing_that_blocks_the_next(sgp, words, tmp_path):
    out = tmp_path / "out"
    assert sgp("run", words[1], "--out", out).code == 4  # no lights
    assert not out.exists()
    assert sgp("run", *words[1:], "--out", out).code == 0


def test_force_removes_files_that_only_the_earlier_result_had(sgp, words, tmp_path):
    normals, out = tmp_path / "n", tmp_path / "out"
    assert sgp(*words, "--out", normals).code == 0
    assert sgp("surface", normals, "--out", out, "--stl").code == 0
    (out / "mine.txt").write_text("keep", encoding="utf-8")
    assert sgp("surface", normals, "--out", out, "--force").code == 0
    assert not (out / "surface.stl").exists()
    assert (out / "mine.txt").exists()


@pytest.mark.parametrize("claimed", [False, True], ids=["before", "while"])
@pytest.mark.parametrize("force", [False, True])
def test_of_two_commands_at_the_same_time_one_is_refused(tmp_path, claimed, force):
    """The other one has written its result before this one, or writes it now."""
    others = []

    @writes_folder("r.json")
    def command(name: str, *, out: Path, force: bool = False) -> Result:
        if claimed:
            claim_folder(out, "r.json")
        while others:
            command(others.pop(), out=out, force=force)
        for _ in range(2):  # a stage of a command may claim the folder again
            claim_folder(out, "r.json")
        return Result(outputs={name: out / name})

    others.append("other")
    out = tmp_path / "out"
    if force and not claimed:
        command("this", out=out, force=True)
    else:
        with pytest.raises(UsageError, match="another command writes its result there"):
            command("this", out=out, force=force)
    command("later", out=out, force=True)
    assert read_record(out / "r.json").parameters["name"] == "later"


@pytest.mark.parametrize("where", ["ball", "ball/results", "ball/../ball"])
def test_results_never_go_into_the_source(sgp, words, recording, where):
    assert "is in the folder of the input" in sgp(
        *words, "--out", recording.parent / where, "--force"
    ).error_line(2)
    assert not (recording / "mask.png").exists()


def test_an_error_is_a_json_object(sgp, words, tmp_path):
    answer = sgp("normals", tmp_path / "nowhere", "--out", tmp_path / "o", "--json")
    report = json.loads(answer.out)
    assert report["ok"] is False
    assert report["exit_code"] == answer.code == 2
    assert f"error: {report['error']}\n" == answer.err


def test_notes_of_an_error_are_printed(monkeypatch, capsys):
    def broken(*_):
        error = BoardError("the line is lost")
        error.add_note("LEDs not confirmed off: no reply")
        raise error

    monkeypatch.setattr("rig.rigs.open_board", broken)
    assert run(build(), ["rig", "off", "--rig", "bench"]) == 3
    message = capsys.readouterr().err
    assert message == "error: the line is lost; LEDs not confirmed off: no reply\n"


@pytest.mark.parametrize(
    "option",
    [
        pytest.param(["surface", "x", "--out", "o", "--pixel-mm", "-3"], id="pixel size"),
        pytest.param(["detail", "separate", "x", "--out", "o", "--w", "0"], id="window"),
        pytest.param(["normals", "x", "--out", "o", "--gamma", "nan"], id="gamma"),
        pytest.param(["demo", "--seed", "-1"], id="seed"),
        pytest.param(["capture", "plan", "--led-count", "0"], id="leds"),
        pytest.param(["rig", "snap", "--rig", "simulated", "--out", "frame.png"], id="suffix"),
        pytest.param(["rig", "snap", "--rig", "simulated", "--out", "."], id="a folder"),
        pytest.param(["calibrate", "spheres", "x", "--out", "lights.lp"], id="lights suffix"),
        pytest.param(["detail", "transfer", "x", "y", "--out", "o", "--at", "5"], id="place"),
    ],
)
def test_options_out_of_range_are_usage_errors(sgp, tmp_path, monkeypatch, option):
    monkeypatch.chdir(tmp_path)
    sgp(*option).error_line(2)


def test_calibrate_spheres_replaces_none_of_its_three_files(sgp, tmp_path):
    (tmp_path / "lights.lp").write_text("mine", encoding="utf-8")
    assert "lights.lp" in sgp(
        "calibrate", "spheres", tmp_path, "--out", tmp_path / "lights.json"
    ).error_line(2)
    assert (tmp_path / "lights.lp").read_text(encoding="utf-8") == "mine"


def test_an_output_below_a_file_is_refused(sgp, words, tmp_path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    sgp(*words, "--out", tmp_path / "file" / "below").error_line(2)


def test_simplified_and_closed_meshes_are_reported(sgp, tmp_path):
    normals, out = tmp_path / "normals.png", tmp_path / "out"
    y, x = np.mgrid[1:-1:60j, -1:1:60j]
    dome = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 1.5]))
    write_exr(normals.with_suffix(".exr"), dome.normals)
    words = ["surface", normals.with_suffix(".exr"), "--out", out, "--pixel-mm", "0.5"]
    metrics = sgp(*words, "--triangles", "700", "--base", "3", "--json").figures()
    assert 600 < metrics["triangles"] <= 700
    assert 0 < metrics["deviation_rms"] < metrics["deviation_largest"] < 0.1
    solid = trimesh.load(out / "solid.stl")
    assert solid.is_watertight
    assert np.ptp(solid.vertices[:, 2]) == pytest.approx(metrics["height_range"] + 3, rel=0.01)
    few = sgp(*words, "--triangles", "9000", "--force", "--json")
    assert "triangles, not more than the 9000 to keep: its meshes are complete" in few.out
