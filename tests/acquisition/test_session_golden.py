"""Golden sessions: they must stay readable, and the newest is reproduced byte by byte.

There is one for each format version. If the format grows, run
``python tests/acquisition/test_session_golden.py`` to rewrite the newest one, which needs a
decision; the older ones stay.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import struct
import tomllib
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    CapturePlan,
    DataError,
    LightErrors,
    Lights,
    Session,
    Setup,
    read_source,
    verify_session,
)
from acquisition.session import (
    CameraRecord,
    CameraReport,
    Echo,
    LightsRecord,
    Manifest,
    RigRecord,
    SessionWriter,
    SoftwareRecord,
)
from acquisition.session.manifest import FORMAT_VERSION, parse_manifest
from acquisition.value_files.lights import lights_json
from acquisition.values import Calibrated, UsedSphere
from rig import Mounting
from rig.arrays import UInt16
from tests.cases import cases

FOLDERS = {
    1: Path(__file__).parent / "golden_session",
    2: Path(__file__).parent / "golden_session_2",
    3: Path(__file__).parent / "golden_session_3",
    4: Path(__file__).parent / "golden_session_4",
    5: Path(__file__).parent / "golden_session_5",
    6: Path(__file__).parent / "golden_session_6",
}
NEWEST = FOLDERS[FORMAT_VERSION]
EVERY = pytest.mark.parametrize("version", FOLDERS)
START = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)

LIGHTS = Lights(
    positions_mm=np.array([[300.0, 0, 300], [0, 300, 300]]),
    ids=("L00", "L03"),
    # Nothing is known of the error of the second position.
    errors=LightErrors(
        np.stack([np.diag([4.0, 1.0, 2.25]), np.full((3, 3), np.nan)]),
        intensity_std=np.array([[0.01, 0.02, 0.03], [0.04, 0.05, 0.06]]),
        axis_std_deg=np.array([1.5, 2.0]),
        mu_std=np.array([0.1, 0.2]),
        residual_px=np.array([0.05, 0.25]),
        spheres=np.array([3, 0]),
    ),
    calibrated=Calibrated(
        START,
        Setup("dome", "Maker", "Eye", "42", CameraModel(np.diag([500.0, 500, 1]), 8, 6, 600.0)),
        (UsedSphere((4.5, 3.25), 2.5, (1.0, 2.0, 3.0), 5.0, "balls"),),
    ),
)


COMPARED = {
    "file": "R_L03_E0.tif",
    "light": "L03_E0_R2.tif",
    "shift_px": [2.25, -1.5],
    "shift_sigma_px": [0.02, 0.03],
    "gain": 0.875,
    "gain_sigma": 0.001,
    "focus": None,
    "focus_sigma": None,
    "other_fraction": 0.0,
    "other_box": None,
    "same_object": True,
    "gain_spread": 0.0,
    "gain_spread_sigma": 0.001,
    "unlike_fraction": 0.0,
    "lights_before": 3,
}
# What the first repeat shows, and a shift after it.
LATER = {"file": "R_L03_E0_R1.tif", "shift_px": [2.25, 0.5], "lights_before": 4}


def samples_of(file: bytes) -> bytes:
    """Return the samples of a TIFF with one strip, located according to TIFF 6.0."""
    (at,) = struct.unpack_from("<I", file, 4)
    (count,) = struct.unpack_from("<H", file, at)
    entries = [struct.unpack_from("<HHII", file, at + 2 + 12 * i) for i in range(count)]
    # A short value is in the first two of its four bytes; the others are zero here.
    found = {tag: value for tag, _, _, value in entries}
    return file[found[273] : found[273] + found[279]]


def pixels_of(number: int) -> UInt16:
    return np.arange(48, dtype=np.uint16).reshape(6, 8) * 80 + number


def clock(first_s: int = 0) -> Callable[[], datetime]:
    ticks = iter(range(first_s, 1000))
    return lambda: START + timedelta(seconds=next(ticks))


def write(folder: Path) -> None:
    content = Manifest(
        started_utc=START,
        operator="Ada Lovelace",
        object="coin 7",
        place="lab 2",
        notes='said "keep"\nand kept',
        software=SoftwareRecord(name="surface-geometry-processing", version="0.0.0"),
        plan=CapturePlan(
            leds=(3, 0),
            exposures_us=(100.0, 12.5),
            exposures_by_led={0: (40.0, 12.5)},
            flats=1,
            repeat_every=3,
            gain_db=1.5,
            sequence=True,
            retakes=2,
            max_clipped_fraction=0.25,
        ),
        rig=RigRecord(
            name="dome",
            driver="bench",
            board="board",
            protocol="2",
            firmware="1.0",
            leds=4,
            mounting=Mounting(rotation_deg=90, mirror=True),
            led_positions_mm=tuple((300.0, 10.0 * led, 320.5) for led in range(4)),
            led_positions_sigma_mm=2.5,
        ),
        camera=CameraRecord(
            width=8,
            height=6,
            bit_depth=12,
            pixel_format="BayerRG12",
            cfa="RGGB",
            vendor="Maker",
            model="Eye",
            serial="42",
            black_level_dn=64.0,
        ),
        lights=LightsRecord.of(LIGHTS),
    )
    with SessionWriter.create(folder, content, clock=clock()) as writer:
        writer.write_event("checked", checks=[{"name": "disk", "state": "ok", "text": "room"}])
        shots = writer.missing
        for number, shot in enumerate(shots[:4], 1):
            writer.write_frame(
                shot,
                pixels_of(number),
                report=CameraReport(
                    exposure_us=99.5 if shot.exposure_us == 100 else shot.exposure_us,
                    gain_db=1.5,
                    frame_id=number,
                    timestamp_ns=10**9 * number,
                    temperature_c=40.25,
                ),
                echo=Echo(seq=number, led=shot.led, lit_us=120, active_us=99),
                above_dark=None if shot.led is None else 0.125,
            )
        writer.write_event("retake", reason="someone walked by", led=3)
        writer.write_frame(shots[3], pixels_of(40), report=CameraReport(frame_id=5))
        writer.write_frame(
            shots[4], pixels_of(50), report=CameraReport(frame_id=6), status="rejected"
        )
        for number, shot in enumerate(shots[4:], 5):
            writer.write_frame(
                shot,
                pixels_of(number),
                report=CameraReport(frame_id=number + 2),
                echo=Echo(seq=9, led=shot.led),
            )
    # One bit changes, and a frame is lost.
    damaged = folder / "frames" / "L03_E1.tif"
    data = damaged.read_bytes()
    damaged.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    (folder / "frames" / "D_40us.tif").unlink()
    module = "acquisition.session"
    with (
        patch(f"{module}.opening.utc_now", clock(100)),
        patch(f"{module}.opening.software_version", return_value="0.0.0"),
        SessionWriter.reopen(folder, set_aside_damaged=True) as writer,
    ):
        for number, shot in enumerate(writer.missing, 60):
            writer.write_frame(shot, pixels_of(number), report=CameraReport(frame_id=number))
        writer.write_event("compared", **COMPARED)
        writer.write_event("compared", **{**COMPARED, **LATER})
        writer.complete()


def test_writing_again_gives_the_same_bytes(tmp_path: Path) -> None:
    write(tmp_path / "s")
    files = [path.relative_to(NEWEST) for path in NEWEST.rglob("*") if path.is_file()]
    written = [p.relative_to(tmp_path / "s") for p in (tmp_path / "s").rglob("*") if p.is_file()]
    assert sorted(written) == sorted(files)
    for name in files:
        assert (tmp_path / "s" / name).read_bytes() == (NEWEST / name).read_bytes(), name


@EVERY
def test_the_golden_session_verifies_by_the_documented_format_alone(version: int) -> None:
    """An independent verifier, written from docs/session-format.md with the standard library."""
    folder = FOLDERS[version]
    data = (folder / "journal.jsonl").read_bytes()
    mark = hashlib.sha256(data).hexdigest()
    assert (folder / "COMPLETE").read_text() == f"{mark}  journal.jsonl\n"
    manifest = (folder / "session.toml").read_bytes()
    assert tomllib.loads(manifest.decode())["format_version"] == version
    previous = "0" * 64
    rows = []
    for line in data.split(b"\n")[:-1]:
        match = re.fullmatch(rb'(.*),"line_sha256":"([0-9a-f]{64})"\}', line)
        assert match is not None
        previous_then = hashlib.sha256(previous.encode() + match[1]).hexdigest()
        assert previous_then == match[2].decode()
        previous = previous_then
        rows.append(json.loads(line))
    assert rows[0]["session_toml_sha256"] == hashlib.sha256(manifest).hexdigest()
    assert [row["seq"] for row in rows] == list(range(len(rows)))
    aside = [row["details"] for row in rows if row.get("event") == "set_aside"]
    for details in aside:
        assert rows[details["frame_seq"]]["file"] == details["file"]
        assert details["kept"] is None or (folder / details["kept"]).is_file()
    gone = {details["frame_seq"] for details in aside}
    frames = [row for row in rows if row["kind"] == "frame" and row["seq"] not in gone]
    for row in frames:
        file = (folder / row["file"]).read_bytes()
        assert (len(file), hashlib.sha256(file).hexdigest()) == (row["bytes"], row["file_sha256"])
        assert len(samples_of(file)) == 96
        assert hashlib.sha256(samples_of(file)).hexdigest() == row["pixels_sha256"]
    stored = {path.name for path in (folder / "frames").iterdir()}
    assert {row["file"] for row in frames} == {f"frames/{name}" for name in stored}


def first_samples(session: Session) -> dict[str, int]:
    return {Path(frame.line.file).stem: int(frame.read()[0, 0]) for frame in session.frames}


def test_reading_the_golden_session_of_version_1() -> None:
    session = Session.open(FOLDERS[1])
    assert verify_session(FOLDERS[1]).problems == ()
    assert session.complete
    # The retake of the first light counts, under its own file name.
    assert first_samples(session) == {
        "D_100us": 1,
        "D_12.5us": 2,
        "L03_E0_R1": 4,
        "L00_E0": 5,
        "L03_E1": 6,
        "L00_E1": 7,
    }
    first = session.recorded[0]
    assert (first.role, first.exposure_us, first.line.timestamp_ns) == ("dark", 99.5, 10**9)
    # 0, 80 ... 3760 and 1 more: the 24th of 48 values is the median from below.
    assert first.line.percentiles_dn["50"] == 23 * 80 + 1
    assert first.line.clipped_fraction == 0.0
    assert session.manifest.camera.cfa == "RGGB"
    assert session.manifest.notes == 'said "keep"\nand kept'
    assert session.lights is not None
    assert session.lights.ids == ("L00", "L03")
    assert [line.event for line in session.events] == ["retake"]
    # The additions of version 2 have the default values.
    assert session.manifest.plan == CapturePlan(
        leds=(3, 0), exposures_us=(100.0, 12.5), gain_db=1.5, repeat=False
    )
    assert session.manifest.mounting == Mounting()
    assert first.line.echo == Echo(seq=1, led=None, lit_us=None, active_us=None)
    assert (first.line.mean_dn, first.line.above_dark) == (None, None)


def test_reading_the_golden_session_of_version_2() -> None:
    session = Session.open(FOLDERS[2])
    assert verify_session(FOLDERS[2]).problems == ()
    assert session.complete
    assert first_samples(session) == {
        "D_100us": 1,
        "D_40us": 2,
        "D_12.5us": 3,
        "L03_E0_R1": 40,
        # The rejected frame is kept under the first name and does not count.
        "L00_E0_R1": 5,
        "L03_E1": 6,
        "L00_E1": 7,
        "F_E0": 8,
        "F_E1": 9,
    }
    plan = session.manifest.plan
    assert plan is not None
    assert plan.exposures_by_led == {0: (40.0, 12.5)}
    assert (plan.flats, plan.retakes, plan.max_clipped_fraction) == (1, 2, 0.25)
    assert plan.sequence
    assert session.manifest.mounting == Mounting(rotation_deg=90, mirror=True)
    fourth = session.recorded[3].line
    assert (fourth.led, fourth.exposure_us) == (3, 99.5)
    assert fourth.echo == Echo(seq=4, led=3, lit_us=120, active_us=99)
    # The mean of 0, 80 ... 3760 and 4 more.
    assert (fourth.mean_dn, fourth.above_dark) == (23.5 * 80 + 4, 0.125)
    assert session.recorded[0].line.above_dark is None
    # The line of a flat has no LED number; its echo names the LED that was on.
    flat = next(frame for frame in session.frames if frame.role == "flat")
    assert (flat.line.led, flat.line.echo and flat.line.echo.led) == (None, 3)
    assert (flat.led, flat.light_id) == (3, "F_E0")
    assert [line.event for line in session.events] == ["checked", "retake"]


def test_reading_the_golden_session_of_version_3() -> None:
    session = Session.open(FOLDERS[3])
    found = verify_session(FOLDERS[3])
    assert (found.problems, found.warnings, found.complete) == ((), (), True)
    assert found.set_aside == ("D_40us.tif", "L03_E1.tif")
    # Shots whose frames were set aside count under the names of their retakes.
    assert first_samples(session) == {
        "D_100us": 1,
        "D_40us_R1": 60,
        "D_12.5us": 3,
        "L03_E0_R1": 40,
        "L00_E0_R1": 5,
        "L03_E1_R1": 61,
        "L00_E1": 7,
        "F_E0": 8,
        "F_E1": 9,
    }
    lost, changed = session.set_aside
    assert (lost.kept, lost.reason) == (None, "is in the journal but not there")
    assert changed.reason == "was changed since it was recorded"
    assert changed.kept == FOLDERS[3] / "derived/set_aside/000_L03_E1.tif"
    assert changed.kept is not None
    assert samples_of(changed.kept.read_bytes()) != pixels_of(6).tobytes()
    assert session.format_version == 3
    names = [line.event for line in session.events]
    assert names == ["checked", "retake", "reopened", "set_aside", "set_aside"]


def test_reading_the_golden_session_of_version_4() -> None:
    """Version 4 keeps all that `lights.json` keeps of lights; older ones have no errors."""
    assert verify_session(FOLDERS[4]).problems == ()
    lights = Session.open(FOLDERS[4]).lights
    assert lights is not None
    assert lights_json(lights, {}) == lights_json(LIGHTS, {})
    for version in (1, 2, 3):
        old = Session.open(FOLDERS[version]).lights
        assert old is not None
        bare = replace(LIGHTS, errors=None, calibrated=None)
        assert lights_json(old, {}) == lights_json(bare, {})


def test_reading_the_golden_session_of_version_5() -> None:
    """Version 5 has the repeat of the first light, and its comparison."""
    found = verify_session(FOLDERS[5])
    assert (found.problems, found.complete) == ((), True)
    codes = [one.code for one in found.warnings]
    assert codes == ["frame-shifted", "light-changed"]
    assert "moved by 2.70 +- 0.04 px (2.25 right, 1.50 up)" in found.warnings[0].text
    session = Session.open(FOLDERS[5])
    repeat = next(frame for frame in session.frames if frame.role == "repeat")
    assert (repeat.path.name, repeat.led, repeat.bracket) == ("R_L03_E0.tif", 3, 0)
    assert repeat.light_id == "R_L03_E0"
    source = read_source(FOLDERS[5])
    assert "repeat" not in {frame.role for frame in source.frames}
    assert len(source.frames) == len(session.frames) - 1
    for version in (1, 2, 3, 4):
        plan = Session.open(FOLDERS[version]).manifest.plan
        assert plan is not None
        assert not plan.repeat


def test_reading_the_golden_session_of_version_6() -> None:
    """Version 6 has several repeats; what one showed is not named again for the next."""
    found = verify_session(FOLDERS[6])
    assert (found.problems, found.complete) == ((), True)
    assert [(one.code, Path(one.where).name) for one in found.warnings] == [
        ("frame-shifted", "R_L03_E0.tif"),
        ("light-changed", "R_L03_E0.tif"),
        ("frame-shifted", "R_L03_E0_R1.tif"),
    ]
    assert "(2.25 right, 0.50 down) since L03_E0_R2.tif, between the lights 3 and 4: put" in (
        found.warnings[2].text
    )
    session = Session.open(FOLDERS[6])
    roles = [frame.role for frame in session.frames]
    assert roles.count("repeat") == 2
    assert "repeat" not in {frame.role for frame in read_source(FOLDERS[6]).frames}
    plan = session.manifest.plan
    assert plan is not None
    assert (plan.repeat_every, plan.lights_before_repeats) == (3, (3, 4))
    for version in (1, 2, 3, 4, 5):
        plan = Session.open(FOLDERS[version]).manifest.plan
        assert plan is not None
        assert plan.repeat_every == 0


@EVERY
def test_the_golden_session_is_read_after_moving(version: int, tmp_path: Path) -> None:
    shutil.copytree(FOLDERS[version], tmp_path / "moved")
    assert verify_session(tmp_path / "moved").ok


LACKS = "unknown key '{}': format version 1 does not have it"
MIRRORED = "leds = 4\n[rig.mounting]\nmirror = true"


@cases(
    ("version", "old", "new", "said"),
    {
        "flats": (1, "gain_db = 1.5", "flats = 1", LACKS.format("plan.flats")),
        "sequence": (1, "gain_db = 1.5", "sequence = false", LACKS.format("plan.sequence")),
        "rig": (1, "leds = 4", MIRRORED, LACKS.format("rig.mounting")),
        "type": (3, "mu = [", "mu = [[1],", "lights.mu.0"),
        "count": (3, "mu = [", "mu = [1.0,", "2 lights need 2 finite values mu"),
        "key": (3, "[lights]", "[lights]\ncalibrated = {}", "unknown key 'lights.c"),
    },
)
def test_keys_and_lights_are_those_of_the_version(
    version: int, old: str, new: str, said: str
) -> None:
    path = FOLDERS[version] / "session.toml"
    data = path.read_text(encoding="utf-8")
    assert old in data
    with pytest.raises(DataError, match=said) as caught:
        parse_manifest(data.replace(old, new).encode(), path)
    assert str(caught.value).startswith(f"{path}: ")


def test_a_session_of_an_unsupported_version_is_not_continued() -> None:
    old, *newer = (Session.open(folder) for folder in FOLDERS.values())
    for session in newer:
        session.manifest.check_current(session.folder)
    with pytest.raises(
        DataError, match=r"has format version 1, this program writes 2, 3, 4, 5 and 6"
    ):
        old.manifest.check_current(old.folder)


if __name__ == "__main__":
    shutil.rmtree(NEWEST, ignore_errors=True)
    write(NEWEST)
