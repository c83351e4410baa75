"""Sessions as sources."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    CapturePlan,
    DataError,
    Lights,
    read_source,
    verify_session,
    write_exr,
    write_png,
)
from acquisition.session import (
    CameraModelRecord,
    CameraRecord,
    LightsRecord,
    Manifest,
    SessionWriter,
)

SHAPE = (4, 6)
K = np.array([[9.0, 0, 3], [0, 9, 2], [0, 0, 1]])
# All six LEDs of the board; the plan uses two of them.
LIGHTS = Lights(positions_mm=np.array([[10.0 * i, 0, 100] for i in range(6)]))
PLAN = CapturePlan(repeat=False, leds=(4, 1), exposures_us=(1000.0, 4000.0), dark=True)


def pixel_value(number: int) -> np.ndarray:
    return np.full(SHAPE, 100 + number, np.uint16)


def session(folder: Path, *, shots: int | None = None, lights: Lights | None = LIGHTS) -> Path:
    manifest = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC),
        operator="op",
        object="owl",
        plan=PLAN,
        camera=CameraRecord(width=6, height=4, bit_depth=12, cfa="RGGB", black_level_dn=64),
        camera_model=CameraModelRecord.of(CameraModel(K, 6, 4, 300.0)),
        lights=None if lights is None else LightsRecord.of(lights),
    )
    with SessionWriter.create(folder, manifest) as writer:
        for number, shot in enumerate(writer.missing[:shots]):
            writer.write_frame(shot, pixel_value(number))
        if shots is None:
            writer.complete()
    return folder


def test_a_complete_session(tmp_path: Path) -> None:
    source = read_source(session(tmp_path / "s"))
    assert source.kind == "session"
    assert [(f.role, f.light_id, f.bracket, f.exposure_us) for f in source.frames] == [
        ("dark", "D_1000us", 0, 1000.0),
        ("dark", "D_4000us", 1, 4000.0),
        ("light", "L04", 1, 4000.0),
        ("light", "L01", 1, 4000.0),
        ("light", "L04", 0, 1000.0),
        ("light", "L01", 0, 1000.0),
    ]
    assert [int(f.read()[0, 0]) for f in source.frames] == [100, 101, 102, 103, 104, 105]
    assert source.light_ids == ("L04", "L01")
    assert source.lights is not None
    np.testing.assert_array_equal(source.lights.positions_mm, [[40, 0, 100], [10, 0, 100]])
    assert (source.cfa, source.black_level, source.white_level) == ("RGGB", 64, 4095)
    assert source.camera is not None
    assert source.camera.working_distance_mm == 300
    assert source.size == SHAPE
    assert source.mask is None
    assert source.normals_truth is None
    assert source.warnings == ()
    others = ("session.toml", "journal.jsonl", "COMPLETE")
    assert {*source.files} == {
        *(frame.path for frame in source.frames),
        *(tmp_path / "s" / name for name in others),
    }


def test_the_mask_in_derived_is_read(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    (folder / "derived").mkdir()
    mask = np.zeros(SHAPE, np.uint8)
    mask[1, 2] = 255
    write_png(folder / "derived" / "mask.png", mask)
    source = read_source(folder)
    assert source.mask is not None
    assert np.argwhere(source.mask).tolist() == [[1, 2]]
    assert folder / "derived" / "mask.png" in source.files
    assert verify_session(folder).ok
    write_png(tmp_path / "given.png", 255 - mask)
    given = read_source(folder, mask_path=tmp_path / "given.png")
    assert given.mask is not None
    assert not given.mask[1, 2]
    assert tmp_path / "given.png" in given.files
    assert folder / "derived" / "mask.png" not in given.files
    write_png(folder / "derived" / "mask.png", mask.T.copy())
    with pytest.raises(DataError, match=r"mask\.png: a mask of 4 x 6"):
        read_source(folder)


def test_the_true_mask_is_used_without_another_mask(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    derived = folder / "derived"
    (derived / "truth").mkdir(parents=True)
    inside = np.zeros(SHAPE, np.uint8)
    inside[3, 5] = 255
    write_png(derived / "truth" / "mask.png", inside)
    source = read_source(folder)
    assert source.mask is not None
    assert np.argwhere(source.mask).tolist() == [[3, 5]]
    assert derived / "truth" / "mask.png" in source.files
    write_png(derived / "mask.png", 255 - inside)
    again = read_source(folder)
    assert again.mask is not None
    assert not again.mask[3, 5]


def test_normals_in_derived_of_another_size_are_refused(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    truth = folder / "derived" / "truth"
    truth.mkdir(parents=True)
    write_exr(truth / "normals.exr", np.zeros((3, 4, 3), np.float32))
    with pytest.raises(DataError, match=r"normals\.exr: float32 of shape \(3, 4, 3\)"):
        read_source(folder)


def test_lights_mask_and_camera_from_the_caller_take_precedence(tmp_path: Path) -> None:
    lights = Lights(directions=np.eye(3), ids=("L01", "L04", "L05"))
    mask = np.zeros(SHAPE, np.uint8)
    mask[2, 3] = 255
    write_png(tmp_path / "mask.png", mask)
    camera = CameraModel(K, 6, 4, 500.0)
    source = read_source(
        session(tmp_path / "s"), lights=lights, mask_path=tmp_path / "mask.png", camera=camera
    )
    assert source.lights is not None
    np.testing.assert_array_equal(source.lights.directions, [[0, 1, 0], [1, 0, 0]])
    assert source.mask is not None
    assert np.argwhere(source.mask).tolist() == [[2, 3]]
    assert source.camera is camera


def test_an_incomplete_session_warns(tmp_path: Path) -> None:
    source = read_source(session(tmp_path / "s", shots=4))
    assert source.light_ids == ("L04", "L01")
    assert len(source.frames) == 4
    assert any("the recording is not complete" in warning for warning in map(str, source.warnings))
    assert any("2 planned frames are missing" in warning for warning in map(str, source.warnings))


def test_a_session_without_lights_or_frames(tmp_path: Path) -> None:
    assert read_source(session(tmp_path / "s", lights=None)).lights is None
    with pytest.raises(DataError, match="the session has no frames"):
        read_source(session(tmp_path / "empty", shots=0))


def test_reading_an_altered_frame_is_refused_by_name(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    path = folder / "frames" / "L01_E0.tif"
    data = bytearray(path.read_bytes())
    data[data.find(pixel_value(3).tobytes()) + 7] ^= 1
    path.write_bytes(data)
    frames = {frame.path.name: frame for frame in read_source(folder).frames}
    frames["L04_E0.tif"].read()
    with pytest.raises(DataError, match=r"L01_E0\.tif"):
        frames["L01_E0.tif"].read()
