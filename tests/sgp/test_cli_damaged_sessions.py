"""Sessions that were damaged after their recording: damage is named, and can be repaired."""

import json
import os
import re
import sys
from itertools import product

import pytest

from tests.acquisition.mutants import rows_of, seal
from tests.quick_sample import quick
from tests.sgp.small_rig import capture


def test_an_interrupted_compaction_is_reported(sgp, recorded):
    (recorded / "derived").mkdir(exist_ok=True)
    (recorded / "COMPLETE").rename(recorded / "derived" / "COMPLETE")
    message = "a compaction was interrupted: compact the session again"
    answer = sgp("capture", "verify", recorded)
    assert (answer.code, message in answer.err) == (4, True)
    assert message in sgp("capture", "info", recorded).err
    assert sgp("capture", "compact", recorded).code == 0
    assert message not in sgp("capture", "verify", recorded).err


def test_verify_names_the_frame_that_one_bit_changed(sgp, recorded):
    frame = recorded / "frames" / "L03_E0.tif"
    data = bytearray(frame.read_bytes())
    data[len(data) // 2] ^= 1
    frame.write_bytes(data)
    answer = sgp("capture", "verify", recorded, "--json")
    assert answer.code == 4
    problems = json.loads(answer.out)["metrics"]["problems"]
    assert len(problems) == 1
    assert "L03_E0.tif" in problems[0]


def test_a_frame_that_is_not_there_is_named(sgp, recorded, tmp_path):
    frame = recorded / "frames" / "L03_E0.tif"
    frame.unlink()
    line = sgp("normals", recorded, "--out", tmp_path / "out").error_line(4)
    assert line == f"error: {frame}: is missing: restore it"


def flip(path):
    data = path.read_bytes()
    path.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


def test_resume_names_damage_and_retakes_it_when_asked(sgp, rig, with_flats, tmp_path):
    out = tmp_path / "s"
    assert capture(sgp, out, "--rig", rig, "--plan", with_flats).code == 2  # the card is missing
    flip(out / "frames" / "L01_E0.tif")
    (out / "frames" / "L02_E0.tif").unlink()
    damaged = (out / "frames" / "L01_E0.tif").read_bytes()
    words = ("capture", "resume", out, "--rig", rig, "--skip-check")
    answer = sgp(*words)
    assert answer.code == 4
    error = answer.err.splitlines()[-1]
    assert error.startswith(f"error: {out / 'frames' / 'L01_E0.tif'}: was changed since")
    assert "2 frames are damaged" in error
    assert (
        f"damaged: {out / 'frames' / 'L02_E0.tif'}: is in the journal but not there" in answer.err
    )
    again = f"capture resume {out} --rig {rig} --skip-check --retake-damaged"
    assert f"`{again}` takes" in answer.err
    assert not (out / "COMPLETE").exists()
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    answer = sgp(*words, "--retake-damaged", "--dry-run", "--json")
    assert (answer.code, json.loads(answer.out)["metrics"]["shots"]) == (0, 2)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    answer = sgp(*words, "--retake-damaged", "--json").ok()
    report = json.loads(answer.out)["metrics"]
    assert report["complete"]
    assert report["set_aside"] == ["frames/L01_E0.tif", "frames/L02_E0.tif"]
    assert "set aside: frames/L01_E0.tif, kept as derived/set_aside/000_L01_E0.tif" in answer.err
    assert (out / "derived/set_aside/000_L01_E0.tif").read_bytes() == damaged
    assert sgp("capture", "verify", out).code == 0
    assert "2 damaged and set aside" in sgp("capture", "info", out).out


def test_a_complete_session_with_a_damaged_frame_is_repaired(sgp, rig, recorded):
    words = ("capture", "resume", recorded, "--rig", rig, "--skip-check")
    assert "no frame is damaged" in sgp(*words, "--retake-damaged").err
    flip(recorded / "frames" / "D_5000us.tif")
    answer = sgp("capture", "verify", recorded)
    assert answer.code == 4
    assert f"`capture resume {recorded} --retake-damaged`, with --rig, takes" in answer.out
    assert "no shot is missing" in sgp(*words).err
    assert sgp(*words, "--retake-damaged").code == 0
    assert sgp("capture", "verify", recorded).code == 0


@pytest.mark.slow
def test_a_frame_line_of_another_led_is_named_and_can_be_retaken(sgp, rig, recorded, tmp_path):
    rows = rows_of(recorded)
    next(row for row in rows if row.get("led") == 3)["echo"]["led"] = 5
    seal(recorded, rows)
    message = "L03_E0.tif was planned with LED 3, but the LED board reports LED 5"
    words = ("capture", "resume", recorded, "--rig", rig, "--skip-check")
    for command in (
        ("capture", "info", recorded),
        ("sgp", "normals", recorded, "--out", tmp_path / "n"),
        words,
    ):
        line = sgp(*command[command[0] == "sgp" :]).error_line(4)
        assert message in line
    again = f"capture resume {recorded} --rig {rig} --skip-check --retake-damaged"
    assert line.endswith(f"`{again}` takes it again")
    assert sgp(*words, "--retake-damaged").code == 0
    assert sgp("capture", "verify", recorded).code == 0


@pytest.mark.slow
def test_missing_lines_are_reported(sgp, rig, recorded):
    seal(recorded, rows_of(recorded)[:4], complete=False)
    hint = "5 files without a line in the journal"
    for words in (
        ("verify", recorded),
        ("info", recorded),
        ("resume", recorded, "--rig", rig, "--skip-check"),
    ):
        answer = sgp("capture", *words)
        assert hint in answer.err + answer.out
        assert "restore journal.jsonl and COMPLETE from a copy before you continue" in (
            answer.err + answer.out
        )
    assert len(list((recorded / "derived" / "unrecorded").iterdir())) == 5


def _pipe(path):
    path.unlink()
    os.mkfifo(path)


def _zero(path):
    path.unlink()
    path.symlink_to("/dev/zero")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such files")
@pytest.mark.parametrize(
    ("replaced", "name"),
    quick(
        product((_pipe, _zero), ("session.toml", "journal.jsonl", "COMPLETE", "frames/L02_E0.tif")),
        every=3,
    ),
)
def test_a_file_that_is_not_regular_is_reported_and_never_waited_for(
    sgp, recorded, tmp_path, name, replaced
):
    replaced(recorded / name)
    sheet = ("info", recorded, "--sheet", tmp_path / "sheet.png")
    export = ("export", recorded, "--format", "exr", "--out", tmp_path / "exr")
    for words in (("verify", recorded), sheet, ("compact", recorded), export):
        answer = sgp("capture", *words)
        assert answer.code == 4, words
        assert name in answer.out + answer.err
        assert re.search("regular file|link that leaves", answer.out + answer.err)
        assert answer.err.count("error:") <= 1
