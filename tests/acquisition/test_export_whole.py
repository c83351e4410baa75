"""Exports are complete or refused: after a kill at any disk call, disk errors, two at once."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from acquisition import (
    DataError,
    Lights,
    MissingPathError,
    StorageError,
    make_folder,
    read_source,
    write_exr,
)
from acquisition.exports import prepare_export
from acquisition.files import staged
from acquisition.files import staging as _staging
from acquisition.imports import read_import
from acquisition.plan import PlannedShot
from acquisition.session import LightsRecord, SessionWriter
from tests.acquisition.dying import dying
from tests.acquisition.small_session import manifest
from tests.forked import ForkServer

SIZE = (12, 16)
LIGHTS = Lights(directions=np.array([[0.0, 0, 1], [0.6, 0, 0.8]]), ids=("L00", "L01"))


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Return a session with two lights, a black level of 64, and true normals."""
    folder = tmp_path / "session"
    camera = {"width": SIZE[1], "height": SIZE[0], "bit_depth": 12, "black_level_dn": 64}
    content = manifest(camera=camera, lights=LightsRecord.of(LIGHTS))
    with SessionWriter.create(folder, content) as writer:
        for led in range(2):
            pixels = np.random.default_rng(led).integers(0, 4096, SIZE).astype(np.uint16)
            writer.write_frame(PlannedShot("light", led, 0, 0, 100.0), pixels)
        writer.complete()
    make_folder(folder / "derived" / "truth")
    normals = np.zeros((*SIZE, 3), np.float32)
    normals[..., 2] = 1
    write_exr(folder / "derived" / "truth" / "normals.exr", normals)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def refused(folder: Path) -> bool:
    """Return whether both readers refuse a folder; they must agree and read the black level."""
    for read in (read_source, read_import):
        try:
            source = read(folder)
        except (DataError, MissingPathError):
            continue
        assert source.black_level == 64
        return False
    return True


PROGRAM = """
from pathlib import Path
from acquisition.exports import prepare_export

def act(session, layout, out, replaced):
    prepare_export(session, layout).write(Path(out), replaced=map(Path, replaced))
"""


@pytest.fixture(scope="module")
def died(forks: ForkServer) -> Iterator[Callable[..., bool]]:
    names = ("open", "write", "fsync", "replace", "unlink", "mkdir", "rmdir")
    with dying(forks, PROGRAM, *names) as died:
        yield died


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="forks processes")
@pytest.mark.parametrize("layout", ["diligent", "lp"])
@pytest.mark.parametrize("before", ["none", "empty", "earlier"])
def test_killed_at_any_call_to_the_disk(
    died: Callable[..., bool], session: Path, tmp_path: Path, layout: Any, before: str
) -> None:
    prepare_export(session, layout).write(tmp_path / "whole")
    whole = contents(tmp_path / "whole")
    older = {**whole, "recording.json": whole["recording.json"].replace(b'"coin"', b'"older"')}
    killed, dies_at, cut_off = True, 0, 0
    while killed:
        dies_at += 1
        out = tmp_path / "out"
        shutil.rmtree(out, ignore_errors=True)
        if before != "none":
            out.mkdir()
        earlier = []
        if before == "earlier":
            for name, data in older.items():
                (out / name).write_bytes(data)
            earlier = list(out.iterdir())
        killed = died(str(session), layout, str(out), [*map(str, earlier)], dies_at=dies_at)
        if refused(out):
            cut_off += 1
        else:
            assert contents(out) in (whole, older)
        if dies_at % 5 == 0:
            prepare_export(session, layout).write(out, replaced=earlier)
            assert contents(out) == whole
            assert sorted(path.name for path in out.iterdir()) == sorted(whole)
    assert contents(out) == whole
    assert cut_off > 10 * len(whole) // 2
    assert dies_at > 40


def test_a_disk_error_while_files_are_moved_leaves_a_folder_that_is_refused(
    session: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    (out / "002.png").mkdir(parents=True)
    (out / "002.png" / "theirs").write_bytes(b"x")
    with pytest.raises(StorageError, match=r"Is a directory|Directory not empty"):
        prepare_export(session, "diligent").write(out)
    with pytest.raises(DataError, match=r"out: is incomplete: .* create them again"):
        read_source(out)
    shutil.rmtree(out / "002.png")
    prepare_export(session, "diligent").write(out)
    assert read_source(out).black_level == 64


def test_a_failing_export_keeps_the_earlier_one(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    prepare_export(session, "lp").write(out)
    before = contents(out)
    export = prepare_export(session, "lp")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(StorageError, match="No space left"):
            export.write(out, replaced=list(out.iterdir()))
    assert contents(out) == before
    assert [path for path in out.iterdir() if path.name.startswith(".")] == []
    assert read_source(out).black_level == 64


def test_an_unfinished_export_is_refused_under_every_path(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    prepare_export(session, "lp").write(out)
    with staged(out) as building:
        (building / "recording.json").write_bytes((out / "recording.json").read_bytes())
        for path in (out, out / "lights.lp", out / "L00.png", building):
            with pytest.raises(DataError, match="is incomplete"):
                read_source(path)
    assert read_source(out).black_level == 64


def test_one_process_at_a_time_writes_into_a_folder(tmp_path: Path) -> None:
    with staged(tmp_path / "out") as first:
        (first / "a").write_bytes(b"1")
        with pytest.raises(StorageError, match="another process is writing files into it"):
            staged(tmp_path / "out").__enter__()
    assert contents(tmp_path / "out") == {"a": b"1"}


@pytest.mark.parametrize("planted", ["link", "file", "pipe", "folder"])
def test_an_entry_with_the_name_of_the_hidden_folder_is_removed_and_not_followed(
    tmp_path: Path, planted: str
) -> None:
    victim, out = tmp_path / "victim", tmp_path / "out"
    victim.mkdir()
    (victim / "theirs").write_bytes(b"mine")
    out.mkdir()
    name = out / _staging._STAGING
    if planted == "link":
        name.symlink_to(victim)
    elif planted == "file":
        name.write_bytes(b"x")
    elif planted == "pipe":
        os.mkfifo(name)
    else:
        name.mkdir()
        (name / "link").symlink_to(victim)
    with staged(out) as place:
        assert place.stat().st_mode & 0o077 == 0
        (place / "a").write_bytes(b"1")
    assert contents(out) == {"a": b"1"}
    assert contents(victim) == {"theirs": b"mine"}


def test_a_missing_image_that_the_record_lists_is_reported(session: Path, tmp_path: Path) -> None:
    """A folder that was copied only in part, with a layout whose tables do not show it."""
    out = tmp_path / "out"
    prepare_export(session, "alicevision").write(out)
    (out / "L01.png").unlink()
    with pytest.raises(DataError, match=r"1 image that recording\.json lists is missing"):
        read_source(out)


def test_exports_of_one_session_are_identical_byte_by_byte(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for layout in ("diligent", "lp", "exr", "alicevision"):
        exports = []
        for day in (1, 2):
            # Writers get the time from here, or in C, where a test cannot set it.
            clock = time.mktime((2030, 1, day, 3, 4, 5 + day, 0, 0, 0))
            monkeypatch.setattr(time, "time", lambda clock=clock: clock)
            monkeypatch.setattr(time, "asctime", lambda *_, clock=clock: time.ctime(clock))
            out = tmp_path / f"{layout}{day}"
            prepare_export(session, layout).write(out)
            exports.append(contents(out))
        assert exports[0] == exports[1]
        assert len(exports[0]) > 3
