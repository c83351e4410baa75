"""``sgp verify``: faults of results of this and of earlier programs, inputs that are elsewhere."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from sgp.results.hashes import seal
from tests.sgp.conftest import Answer


@pytest.fixture
def normals(sgp, recording, tmp_path, monkeypatch) -> Path:
    """A result with relative paths, computed in the folder above the recording."""
    monkeypatch.chdir(tmp_path)
    assert sgp("normals", "ball", "--lights", "lights.json", "--out", "out").code == 0
    return tmp_path / "out"


@pytest.fixture
def verify(sgp) -> Callable[..., tuple[Answer, list[dict[str, str]]]]:
    def call(*paths: object) -> tuple[Answer, list[dict[str, str]]]:
        answer = sgp("verify", *paths, "--json")
        return answer, json.loads(answer.out)["notices"]

    return call


def rewritten(record: Path, **changes: object) -> None:
    content = json.loads(record.read_text()) | changes
    record.write_text(json.dumps(content | {"record_sha256": seal(content)}, indent=2))


def of_earlier_program(out: Path) -> None:
    content = json.loads((out / "normals.json").read_text())
    del content["files"], content["record_sha256"]
    (out / "normals.json").write_text(json.dumps(content, indent=2))


def test_a_good_result_is_found_good_from_any_folder(verify, normals, tmp_path, monkeypatch):
    other = tmp_path / "elsewhere"
    (other / "ball").mkdir(parents=True)
    (other / "ball" / "ball.0.png").write_bytes(b"another recording of the same name")
    for place in (tmp_path, other):
        monkeypatch.chdir(place)
        answer, notices = verify(normals)
        assert (answer.code, notices) == (0, [])
    assert json.loads(answer.out)["metrics"]["inputs"] == 9


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        pytest.param("albedo.exr", Path.unlink, "is missing", id="missing"),
        pytest.param(
            "albedo.exr", lambda path: os.truncate(path, 99), "is cut short (99", id="cut"
        ),
        pytest.param("albedo.exr", lambda p: p.write_bytes(p.read_bytes() + b"x"), "was changed"),
        pytest.param(
            "used.exr", lambda p: (p.unlink(), os.mkfifo(p)), "is not a file", id="a pipe"
        ),
    ],
)
def test_a_damaged_file_is_named_with_its_command(verify, normals, name, change, said) -> None:
    change(normals / name)
    answer, notices = verify(normals)
    assert answer.code == 4
    (notice,) = notices
    assert (notice["code"], notice["where"]) == ("output-damaged", str(normals / name))
    assert notice["text"].startswith(said)
    assert notice["text"].endswith("it is a result of `sgp normals`: run this command again")


def test_results_of_earlier_programs_are_read(verify, normals) -> None:
    of_earlier_program(normals)
    answer, notices = verify(normals)
    assert answer.code == 0
    assert [notice["code"] for notice in notices] == ["output-without-hash"]
    os.truncate(normals / "normals.exr", 2000)
    (normals / "used.exr").unlink()
    answer, notices = verify(normals)
    assert answer.code == 4
    assert {Path(notice["where"]).name for notice in notices} == {"normals.exr", "used.exr", ""}


def test_inputs_that_moved_are_stated_and_those_that_changed_named(
    verify, normals, tmp_path
) -> None:
    content = (tmp_path / "lights.json").read_bytes()
    (tmp_path / "lights.json").write_bytes(content + b"\n")
    shutil.move(tmp_path / "ball", tmp_path / "moved")
    answer, notices = verify(normals)
    assert answer.code == 4
    assert {notice["code"] for notice in notices} == {"input-changed", "input-missing"}
    assert "7 more" in next(one["text"] for one in notices if one["code"] == "input-missing")
    (tmp_path / "lights.json").write_bytes(content)
    assert verify(normals)[0].code == 0


@pytest.mark.parametrize(
    ("content", "said"),
    [
        pytest.param(b"", "is not JSON", id="empty"),
        pytest.param(b'{"format": "sgp-result", "vers', "is the record of a result and is cut"),
        pytest.param(b"\xff\xfe", "utf-8", id="no text"),
    ],
)
def test_records_that_cannot_be_read_are_named(verify, normals, content, said) -> None:
    (normals / "normals.json").write_bytes(content)
    answer, notices = verify(normals)
    assert answer.code == 4
    assert said in notices[0]["text"]


@pytest.mark.parametrize("name", ["../" * 30 + "dev/zero", "/dev/zero", "x" * 5000, "a\0b", "."])
def test_hostile_names_in_records_end_as_faults(verify, normals, name) -> None:
    known = {"bytes": 1, "sha256": "0" * 64}
    rewritten(normals / "normals.json", outputs={"normals": name}, files={name: known})
    answer, notices = verify(normals)
    assert answer.code == 4
    assert [notice["code"] for notice in notices] == ["output-damaged"]


def test_a_changed_record_is_named(verify, normals) -> None:
    record = normals / "normals.json"
    record.write_text(record.read_text().replace("sgp normals", "sgp normalz", 1))
    answer, (notice,) = verify(normals)
    assert (answer.code, notice["where"]) == (4, str(record))


def test_links_to_results_are_followed_once_and_hidden_files_ignored(verify, normals) -> None:
    archive = normals.parent / "archive"
    archive.mkdir()
    (archive / "owl").symlink_to(normals)
    (archive / "circle").symlink_to(archive)
    (normals / "._normals.json").write_bytes(b"\0\5\x16\7")
    answer, notices = verify(archive)
    assert (answer.code, notices) == (0, [])
    assert json.loads(answer.out)["metrics"]["records"] == 1


def test_what_has_no_record_is_refused(sgp, recording) -> None:
    line = sgp("verify", recording).error_line(2)
    assert "has no record of a result, as if the command that writes it was stopped" in line


@pytest.mark.parametrize("whole", [True, False])
def test_stages_without_their_summary_are_stated(verify, normals, tmp_path, whole) -> None:
    """Before, the result of a run that had been stopped was found good without a word."""
    stages = [tmp_path / "run" / name for name in ("normals", "detail")]
    for stage in stages:
        shutil.copytree(normals, stage)
        rewritten(stage / "normals.json", command="sgp run")
    if whole:
        shutil.copy(stages[0] / "normals.json", tmp_path / "run" / "summary.json")
        rewritten(tmp_path / "run" / "summary.json", outputs={}, files={})
    _, notices = verify(tmp_path / "run")
    found = [one["where"] for one in notices if one["code"] == "result-unfinished"]
    assert found == ([] if whole else [str(tmp_path / "run")])


def test_a_compacted_session_is_the_same_input(sgp, verify, recording, tmp_path) -> None:
    session, lights = tmp_path / "session", ("--lights", tmp_path / "lights.json")
    assert sgp("capture", "import", recording, "--out", session, *lights).code == 0
    assert sgp("normals", session, *lights, "--out", tmp_path / "out").code == 0
    assert sgp("capture", "compact", session).code == 0
    answer, notices = verify(tmp_path / "out")
    assert (answer.code, notices) == (0, [])


def test_a_later_command_names_the_command_to_run_again(sgp, normals, tmp_path) -> None:
    os.truncate(normals / "normals.exr", 2000)
    text = sgp("detail", "separate", normals, "--out", tmp_path / "detail").error_line(4)
    assert text.endswith(": run this command again")
    assert "it is a result of `sgp normals` and is cut short (2000 of" in text
    of_earlier_program(normals)
    text = sgp("detail", "separate", normals, "--out", tmp_path / "detail").error_line(4)
    assert text.endswith("it is a result of `sgp normals`: run this command again")
