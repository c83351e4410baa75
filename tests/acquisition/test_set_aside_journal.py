"""The journal of frames that were set aside: upgrade, checked events, and kills at any call."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from acquisition import DataError, Session, record, resume, verify_session
from acquisition.session import SessionWriter
from rig import Rig
from tests.acquisition.dying import dying
from tests.acquisition.fake_bench import LABELS, PLAN, Bench, cut, events_of, flip
from tests.acquisition.interruptions import make_older
from tests.acquisition.mutants import rows_of, seal
from tests.forked import ForkServer

# PLAN has LEDs 3, 0, 5 at 200 and 50 us, with dark and ambient frames: ten shots.


def test_version_2_is_upgraded_by_an_event_and_only_if_needed(
    rig: Rig, bench: Bench, tmp_path: Path
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 8)
    toml = folder / "session.toml"
    make_older(folder, 2)
    written = toml.read_bytes()
    shutil.copytree(folder, tmp_path / "whole")
    assert resume(rig, tmp_path / "whole", retake_damaged=True).format_version == 2
    flip(folder / "frames/L03_E0.tif")
    bench.shots.clear()
    session = resume(rig, folder, retake_damaged=True)
    assert (session.complete, session.format_version) == (True, 3)
    assert toml.read_bytes() == written
    assert [line.event for line in events_of(session)][-3:] == ["reopened", "upgraded", "set_aside"]
    assert verify_session(folder).ok
    # One upgrade is sufficient.
    flip(folder / "frames/L00_E0.tif")
    session = resume(rig, folder, retake_damaged=True)
    assert [line.event for line in events_of(session)].count("upgraded") == 1
    assert verify_session(folder).ok


def event(rows: list[dict[str, Any]], name: str, **details: Any) -> dict[str, Any]:
    head = {"kind": "event", "seq": len(rows), "time_utc": rows[0]["time_utc"]}
    return {**head, "event": name, "details": details}


UPGRADE = {"from_version": 2, "to_version": 3, "software_version": "1"}


EVENTS = {
    "good": (3, "set_aside", {}, None),
    "no frame": (3, "set_aside", {"frame_seq": 0}, "line 12: sets frames"),
    "not its file": (3, "set_aside", {"file": "frames/L00_E0.tif"}, "line 12: sets"),
    "kept in frames": (3, "set_aside", {"kept": "frames/x.tif"}, "kept"),
    "kept outside": (3, "set_aside", {"kept": "derived/set_aside/../../x"}, "kept"),
    "more": (3, "set_aside", {"more": 1}, "unknown key 'more'"),
    "unknown to version 2": (2, "set_aside", {}, None),
    "upgrade": (2, "upgraded", UPGRADE, None),
    "upgrade of version 3": (3, "upgraded", UPGRADE, "it has version 3"),
    "beyond": (2, "upgraded", {**UPGRADE, "to_version": 4}, "to_version"),
}


@pytest.mark.parametrize(("version", "name", "changed", "said"), EVENTS.values(), ids=EVENTS)
def test_events_that_change_what_counts_are_checked(
    rig: Rig,
    bench: Bench,
    tmp_path: Path,
    version: int,
    name: str,
    changed: dict[str, Any],
    said: str | None,
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 9)
    make_older(folder, version)
    rows = rows_of(folder)[:11]
    row = next(row for row in rows if row.get("file") == "frames/L03_E0.tif")
    details = changed
    if name == "set_aside":
        good = {"frame_seq": row["seq"], "file": row["file"], "kept": None, "reason": "why"}
        details = {**good, **changed}
    while len(rows) < 11:
        rows.append(event(rows, "note"))
    seal(folder, [*rows, event(rows, name, **details)])
    if said is None:
        session = Session.open(folder)
        gone = name == "set_aside" and version == 3
        assert len(session.set_aside) == gone
        assert ("L03_E0.tif" in {shot.file for shot in session.missing}) == gone
        assert session.format_version == (3 if name == "upgraded" else version)
        return
    with pytest.raises(DataError, match=said):
        Session.open(folder)


@pytest.mark.parametrize("event", ["set_aside", "upgraded", "compacted", "reopened"])
def test_reserved_events_cannot_be_written_directly(
    rig: Rig, bench: Bench, tmp_path: Path, event: str
) -> None:
    folder = cut(rig, bench, tmp_path / "s", 8)
    with SessionWriter.reopen(folder) as writer, pytest.raises(DataError, match=event):
        writer.write_event(event)


# ---------------------------------------------------------------- killed processes


# It sets damaged frames aside.
PROGRAM = """
from pathlib import Path
import numpy as np
from acquisition.pixels import measure_quality
from acquisition.session import SessionWriter

measure_quality(np.zeros((16, 16), np.uint16), white_level_dn=4095)  # compile it once

def act(folder):
    SessionWriter.reopen(Path(folder), set_aside_damaged=True).close()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="forks processes")
def test_a_kill_at_any_call_to_the_disk_loses_nothing(
    rig: Rig, bench: Bench, tmp_path: Path, forks: ForkServer
) -> None:
    """A changed and a lost frame of a complete session of version 2."""
    model = tmp_path / "model"
    record(rig, PLAN, model, LABELS)
    make_older(model, 2)
    flip(model / "frames/L03_E0.tif")
    (model / "frames/D_200us.tif").unlink()
    damaged = (model / "frames/L03_E0.tif").read_bytes()
    killed, dies_at = True, 0
    names = ("write", "fsync", "replace", "rename", "mkdir", "unlink")
    with dying(forks, PROGRAM, *names) as died:
        while killed:
            dies_at += 1
            folder = tmp_path / f"s{dies_at}"
            shutil.copytree(model, folder)
            killed = died(str(folder), dies_at=dies_at)
            found = verify_session(folder)
            assert all(
                "L03_E0.tif" in problem or "D_200us.tif" in problem for problem in found.problems
            )
            bench.shots.clear()
            session = resume(rig, folder, retake_damaged=True)
            assert (session.complete, bench.shots) == (True, [None, 3])
            assert verify_session(folder).problems == ()
            files = {one.frame.path.name: one.kept for one in session.set_aside}
            assert list(files) == ["D_200us.tif", "L03_E0.tif"]
            assert files["D_200us.tif"] is None
            shelf = folder / "derived/set_aside"
            assert {path: path.read_bytes() for path in shelf.iterdir()} == {
                files["L03_E0.tif"]: damaged
            }
            shutil.rmtree(folder)
    assert dies_at > 15
