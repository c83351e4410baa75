"""Inputs are hashed as they were used: changes between reading and end, and what looks like one."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import pytest

import rig
from acquisition import DataError
from rig import read_bounded
from rig.files import files_read, status_when_read
from sgp.results import input_hashes, output_files


def replace(path: Path, content: bytes = b"new") -> None:
    other = path.with_name("other")
    other.write_bytes(content)
    shutil.copystat(path, other)
    other.replace(path)


def rewrite(path: Path) -> None:
    times = path.stat().st_atime_ns, path.stat().st_mtime_ns
    path.write_bytes(b"new")
    os.utime(path, ns=times)


def link(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(b"new")
    shutil.copystat(path, other)
    path.unlink()
    path.symlink_to(other)


HARMLESS = {
    "touched": os.utime,
    "permissions": lambda path: path.chmod(0o600),
    "the same content": lambda path: replace(path, b"old"),
    "a hard link": lambda path: os.link(path, path.with_name("backup")),
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "image.tif"
    path.write_bytes(b"old")
    os.utime(path, ns=(1, 1))
    time.sleep(0.02)  # the clock of a file system has steps of some milliseconds
    return path


@pytest.mark.parametrize("early", [False, True])
@pytest.mark.parametrize(
    ("change", "what"),
    [
        pytest.param(replace, "changed", id="replaced, same size and time"),
        pytest.param(rewrite, "changed", id="rewritten, time set back"),
        pytest.param(lambda path: path.write_bytes(b"older"), "changed", id="longer"),
        pytest.param(lambda path: path.write_bytes(b""), "changed", id="emptied"),
        pytest.param(link, "changed", id="a link to another file"),
        pytest.param(Path.unlink, "removed", id="removed"),
    ],
)
def test_a_file_that_changed_after_it_was_read_is_named(file, early, change, what) -> None:
    with files_read():
        read_bounded(file)
        if early:
            input_hashes([file])
        change(file)
        with pytest.raises(DataError, match=rf"image\.tif: was {what} while this command used it"):
            input_hashes([file])


@pytest.mark.parametrize("change", HARMLESS.values(), ids=HARMLESS)
def test_the_same_content_is_the_same_file_if_it_was_hashed_before(file, change) -> None:
    with files_read():
        read_bounded(file)
        early = input_hashes([file])
        change(file)
        assert input_hashes([file]) == early


def test_without_an_early_hash_the_content_before_is_not_known(file) -> None:
    with files_read():
        read_bounded(file)
        os.utime(file)
        with pytest.raises(DataError, match="was changed"):
            input_hashes([file])


def test_each_command_begins_anew(file) -> None:
    with files_read():
        read_bounded(file)
        with files_read() as found:
            file.write_bytes(b"newer")
            read_bounded(file)
            assert [status.size for status in found.values()] == [5]
            input_hashes([file])
        status = status_when_read(file)
        assert status is not None
        assert status.size == 3
    assert status_when_read(file) is None


def test_a_missing_file_that_was_never_read_is_named(tmp_path) -> None:
    with files_read(), pytest.raises(DataError, match="none: is missing: restore it"):
        input_hashes([tmp_path / "none"])


def test_pages_and_folders_are_no_final_files(tmp_path) -> None:
    for name in ("a.exr", "report.html"):
        (tmp_path / name).touch()
    paths = [tmp_path / name for name in ("a.exr", "a.exr", "report.html", "gone.png")]
    assert output_files([*paths, tmp_path]) == [tmp_path / "a.exr"]


COMMANDS = {
    "normals": ("normals", "ball", "--lights", "lights.json", "--out", "normals-again"),
    "in bands": ("run", "ball", "--lights", "lights.json", "--memory", "1M", "--out", "run"),
    "separate": ("detail", "separate", "normals", "--out", "detail"),
    "surface": ("surface", "normals", "--sigma", "normals/normal_sigma_deg.exr", "--out", "s"),
    "curvature": ("curvature", "normals", "--out", "curvature"),
    "compare": ("compare", "normals", "normals", "--out", "compare"),
    "session": ("normals", "session", "--lights", "lights.json", "--out", "of-session"),
}


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_the_readers_of_a_command_note_all_its_inputs(
    sgp, recording, tmp_path, monkeypatch, words
) -> None:
    """A reader that opens files in another way would not be protected."""
    monkeypatch.chdir(tmp_path)
    lights = ("--lights", "lights.json")
    assert sgp("normals", "ball", *lights, "--out", "normals").code == 0
    if "session" in words:
        imported = ("capture", "import", "ball", "--out", "session", *lights)
        assert sgp(*imported).code == 0
    unnoted: list[Path] = []

    def checked(files):
        files = list(files)
        unnoted.extend(file for file in files if rig.files.status_when_read(file) is None)
        return input_hashes(files)

    monkeypatch.setattr("sgp.results.output.input_hashes", checked)
    answer = sgp(*words)
    assert answer.code == 0 or "too small" in answer.err, answer
    if answer.code:  # the message names the least memory
        least = answer.err.partition("at least --memory ")[2].split()[0].rstrip(".:;,")
        sgp(*[least if word == "1M" else word for word in words]).ok()
    assert unnoted == []
