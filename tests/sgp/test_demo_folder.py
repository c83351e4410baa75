"""The folder of a demo: files of a demo are replaced, also after a kill; other files never."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sgp.cli.exit import UsageError
from sgp.results import claimed
from sgp.results.demo_folder import MARK

# A demo that is killed in its second stage.
KILLED = """
import os, signal, sys
from pathlib import Path
from sgp.results.demo_folder import claimed
out = Path(sys.argv[1])
with claimed(out, force=False) as folder:
    folder.begin("calibration")
    (out / "calibration").mkdir()
    (out / "calibration" / "session.toml").write_text("done")
    folder.begin("recording")
    (out / "recording" / "frames").mkdir(parents=True)
    (out / "recording" / "frames" / "half.tif").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    out = tmp_path / "demo"
    done = subprocess.run([sys.executable, "-P", "-c", KILLED, str(out)], check=False)
    assert done.returncode == -signal.SIGKILL
    assert (out / "recording" / "frames" / "half.tif").exists()
    return out


def refused(out: Path, says: str, *, force: bool = False) -> None:
    with pytest.raises(UsageError, match=says):
        claimed(out, force=force).__enter__()


def names(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir())


def test_a_killed_demo_can_be_repeated(killed):
    with claimed(killed, force=False) as folder:
        assert names(killed) == [MARK]
        folder.begin("camera.json")
        (killed / "camera.json").write_text("{}")
    assert names(killed) == [MARK, "camera.json"]
    with claimed(killed, force=False):
        assert names(killed) == [MARK]


@pytest.mark.parametrize(
    "file",
    [
        pytest.param("lights.json", id="a file of a stage that had not begun"),
        pytest.param("overview.png", id="another"),
        pytest.param("calibration/session.toml", id="a finished file, changed"),
        pytest.param("calibration/notes.txt", id="a file next to finished ones"),
    ],
)
def test_other_files_are_never_replaced(killed, file):
    (killed / file).write_text("mine")
    refused(killed, f"{file} was not written by a demo", force=True)
    assert (killed / file).read_text() == "mine"
    assert (killed / "recording" / "frames" / "half.tif").exists()


def test_other_names_stay(killed):
    (killed / "notes.txt").write_text("mine")
    with claimed(killed, force=False):
        assert names(killed) == [MARK, "notes.txt"]


def test_links_are_refused_and_not_followed(killed, tmp_path):
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "file").write_text("x")
    (killed / "recording" / "link").symlink_to(victim)
    refused(killed, "link was not written by a demo", force=True)
    assert (victim / "file").exists()


def test_a_folder_with_other_files_is_refused(tmp_path):
    (tmp_path / "lights.json").write_text("mine")
    refused(tmp_path, "already contains files")
    refused(tmp_path, "was not written by a demo", force=True)


def test_a_mark_of_an_earlier_version_is_understood(tmp_path):
    with claimed(tmp_path / "demo", force=False) as folder:
        folder.begin("camera.json")
        (tmp_path / "demo" / "camera.json").write_text("{}")
    mark = tmp_path / "demo" / MARK
    mark.write_text(json.dumps(json.loads(mark.read_text())["files"]))
    with claimed(tmp_path / "demo", force=False):
        assert names(tmp_path / "demo") == [MARK]


@pytest.mark.parametrize("text", ["", "{", "[]", '{"files": 3}', '{"unfinished": 3}', "null"])
def test_files_below_a_damaged_mark_are_not_replaced(killed, text):
    (killed / MARK).write_text(text)
    refused(killed, "was not written by a demo")


def test_two_demos_do_not_run_in_one_folder(tmp_path):
    with claimed(tmp_path / "demo", force=False):
        refused(tmp_path / "demo", "another demo is running")
        assert names(tmp_path / "demo") == [MARK]


def test_a_demo_killed_while_writing_its_mark_can_be_repeated(tmp_path):
    (tmp_path / f".part-{MARK}").write_text("{")
    with claimed(tmp_path, force=False):
        assert names(tmp_path) == [MARK]


def test_the_next_demo_replaces_the_files_of_one_that_failed(tmp_path):
    def interrupted() -> None:
        with claimed(tmp_path / "demo", force=False) as folder:
            folder.begin("recording")
            (tmp_path / "demo" / "recording").write_text("half")
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    with claimed(tmp_path / "demo", force=False):
        assert names(tmp_path / "demo") == [MARK]
