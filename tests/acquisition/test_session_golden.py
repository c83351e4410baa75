"""A session kept as files: what was written once must stay readable, and be written the same."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import struct
import tomllib
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from acquisition import _session_writer
from acquisition._journal import Echo
from acquisition._lights import Lights
from acquisition._manifest import (
    CameraRecord,
    LightsRecord,
    Manifest,
    RigRecord,
    SoftwareRecord,
)
from acquisition._plan import CapturePlan
from acquisition._session import Session
from acquisition._session_writer import SessionWriter
from acquisition._verify import verify_session

GOLDEN = Path(__file__).parent / "golden_session"
START = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


def tiff(path: Path, pixels: npt.NDArray[np.uint16]) -> None:
    """Write the least TIFF there is, so that the bytes do not depend on a library's version."""
    height, width = pixels.shape
    tags = [(256, width), (257, height), (258, 16), (259, 1), (262, 1), (273, 8), (277, 1)]
    tags += [(278, height), (279, pixels.nbytes)]
    data = struct.pack("<2sHI", b"II", 42, 8 + pixels.nbytes) + pixels.astype("<u2").tobytes()
    data += struct.pack("<H", len(tags))
    data += b"".join(struct.pack("<HHIHH", tag, 3, 1, value, 0) for tag, value in tags)
    path.write_bytes(data + bytes(4))


def pixels_of(number: int) -> npt.NDArray[np.uint16]:
    return np.arange(48, dtype=np.uint16).reshape(6, 8) * 80 + number


def clock() -> Callable[[], datetime]:
    ticks = iter(range(1000))
    return lambda: START + timedelta(seconds=next(ticks))


def write(folder: Path) -> None:
    told = Manifest(
        started_utc=START,
        operator="Ada Lovelace",
        object="coin 7",
        place="lab 2",
        notes='said "keep"\nand kept',
        software=SoftwareRecord(name="surface-geometry-processing", version="0.0.0"),
        plan=CapturePlan(leds=(3, 0), exposures_us=(100.0, 12.5), gain_db=1.5),
        rig=RigRecord(
            name="dome", driver="bench", board="board", protocol="1", firmware="1.0", leds=4
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
        lights=LightsRecord.of(
            Lights(positions_mm=np.array([[300.0, 0, 300], [0, 300, 300]]), ids=("L00", "L03"))
        ),
    )
    with SessionWriter.create(folder, told, clock=clock()) as writer:
        shots = writer.missing
        for number, shot in enumerate(shots[:3], 1):
            writer.write_frame(
                shot,
                pixels_of(number),
                exposure_us=99.5 if shot.bracket == 0 else 12.5,
                gain_db=1.5,
                frame_id=number,
                timestamp_ns=10**9 * number,
                temperature_c=40.25,
                echo=Echo(seq=number, led=shot.led),
            )
        writer.write_event("retake", reason="someone walked by", led=3)
        writer.write_frame(shots[2], pixels_of(4), frame_id=4)
        for number, shot in enumerate(shots[3:], 5):
            writer.write_frame(shot, pixels_of(number), frame_id=number)
        writer.complete()


def test_writing_again_gives_the_same_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_session_writer, "write_tiff", tiff)
    write(tmp_path / "s")
    files = [path.relative_to(GOLDEN) for path in GOLDEN.rglob("*") if path.is_file()]
    written = [p.relative_to(tmp_path / "s") for p in (tmp_path / "s").rglob("*") if p.is_file()]
    assert sorted(written) == sorted(files)
    for name in files:
        assert (tmp_path / "s" / name).read_bytes() == (GOLDEN / name).read_bytes(), name


def test_the_kept_session_is_whole_by_the_written_format_alone() -> None:
    """A verifier of its own, written from docs/session-format.md with the standard library."""
    data = (GOLDEN / "journal.jsonl").read_bytes()
    mark = hashlib.sha256(data).hexdigest()
    assert (GOLDEN / "COMPLETE").read_text() == f"{mark}  journal.jsonl\n"
    manifest = (GOLDEN / "session.toml").read_bytes()
    assert tomllib.loads(manifest.decode())["format_version"] == 1
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
    frames = [row for row in rows if row["kind"] == "frame"]
    for row in frames:
        file = (GOLDEN / row["file"]).read_bytes()
        assert (len(file), hashlib.sha256(file).hexdigest()) == (row["bytes"], row["file_sha256"])
        # The samples of these files start after an 8-byte header.
        assert hashlib.sha256(file[8 : 8 + 96]).hexdigest() == row["pixels_sha256"]
    stored = {path.name for path in (GOLDEN / "frames").iterdir()}
    assert {row["file"] for row in frames} == {f"frames/{name}" for name in stored}


def test_the_kept_session_reads_as_what_it_was() -> None:
    session = Session.open(GOLDEN)
    assert verify_session(GOLDEN).problems == ()
    assert session.complete
    taken = {frame.line.file: frame.read() for frame in session.frames}
    # The retake of the first light counts, under the name that says so.
    assert {Path(file).stem: int(pixels[0, 0]) for file, pixels in taken.items()} == {
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


def test_the_kept_session_is_read_after_moving(tmp_path: Path) -> None:
    shutil.copytree(GOLDEN, tmp_path / "moved")
    assert verify_session(tmp_path / "moved").ok
