"""Export of sessions: content of the layouts, round trips through import, refusals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    DataError,
    Lights,
    MissingPathError,
    Session,
    StorageError,
    import_frames,
    read_image,
    read_lights,
    read_source,
    verify_session,
)
from acquisition.exports import Layout, prepare_export
from acquisition.imports import read_import
from acquisition.plan import PlannedShot
from acquisition.session import LightsRecord, SessionWriter, compact_session
from rig import Mounting
from tests.acquisition.exported_session import (
    LEDS,
    NEAR,
    SIZE,
    TEXTS,
    lit,
    picture,
    same_lights,
    session,
)
from tests.acquisition.small_session import manifest
from tests.quick_sample import quick


def same_pixels(folder: Path, other: Path) -> None:
    one, two = lit(folder), lit(other)
    assert list(one) == list(two) == list(LEDS)
    for led, pixels in one.items():
        np.testing.assert_array_equal(two[led], pixels)


def record(folder: Path, shots: dict[PlannedShot, int], lights: Lights | None = None) -> None:
    """Record shots, each with the picture of a number."""
    content = manifest(SIZE, 12, lights=None if lights is None else LightsRecord.of(lights))
    with SessionWriter.create(folder, content) as writer:
        for shot, number in shots.items():
            writer.write_frame(shot, picture(number, SIZE))
        writer.complete()


@pytest.mark.parametrize("layout", ["diligent", "lp", "alicevision"])
@pytest.mark.parametrize(
    ("channels", "cfa"),
    [
        pytest.param(1, None, id="grey"),
        pytest.param(3, None, id="rgb"),
        pytest.param(1, "GRBG", id="mosaic"),
    ],
)
@pytest.mark.parametrize(
    "lights",
    [
        pytest.param(NEAR, id="near"),
        pytest.param(NEAR.distant(), id="distant", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize(
    "compacted", quick([False, True], every=2), ids=["as-recorded", "compacted"]
)
def test_export_and_import_lose_nothing(
    tmp_path: Path, layout: Layout, channels: int, cfa: str | None, lights: Lights, compacted: bool
) -> None:
    folder = session(tmp_path / "s", channels=channels, cfa=cfa, lights=lights)
    if compacted:
        compact_session(folder)
    prepare_export(folder, layout).write(tmp_path / "out")
    source = read_import(tmp_path / "out")
    assert source.warnings == ()
    assert [name for name in source.ignored if not name.endswith(".mat")] == []
    back = import_frames(source, tmp_path / "back")
    same_pixels(folder, tmp_path / "back")
    same_lights(Session.open(folder).lights, back.lights)
    assert verify_session(tmp_path / "back").ok
    was, now = Session.open(folder).manifest, back.manifest
    assert now.camera == was.camera
    assert now.camera_model == was.camera_model
    assert {name: getattr(now, name) for name in TEXTS} == TEXTS
    assert now.started_utc == was.started_utc
    assert {frame.exposure_us for frame in back.frames} == {1000.0}
    before, after = read_source(folder), read_source(tmp_path / "back")
    assert before.mask is not None
    np.testing.assert_array_equal(after.mask, before.mask)
    if layout == "diligent":
        assert before.normals_truth is not None
        np.testing.assert_allclose(after.normals_truth, before.normals_truth, atol=1e-7)


def test_one_bracket_is_exported_and_the_others_are_reported(tmp_path: Path) -> None:
    folder = session(tmp_path / "s", brackets=(1000.0, 250.0))
    export = prepare_export(folder, "diligent", bracket=1)
    export.write(tmp_path / "out")
    assert {frame.exposure_us for frame in export.notes.frames} == {250.0}
    np.testing.assert_array_equal(read_image(tmp_path / "out" / "002.png"), lit(folder, 1)[1])
    assert any("4 of other brackets, 2 dark" in line for line in map(str, export.warnings))
    with pytest.raises(DataError, match="bracket 2: the brackets are 0, 1"):
        prepare_export(folder, "diligent", bracket=2)


def test_intensities_of_lights_are_scaled_by_their_exposures(tmp_path: Path) -> None:
    exposures = dict(zip(LEDS, (1000.0, 500.0, 2000.0, 1000.0), strict=True))
    shots = [PlannedShot("light", led, 0, 0, time_us) for led, time_us in exposures.items()]
    record(tmp_path / "s", dict(zip(shots, LEDS, strict=True)), NEAR)
    export = prepare_export(tmp_path / "s", "diligent")
    export.write(tmp_path / "out")
    written = np.loadtxt(tmp_path / "out" / "light_intensities.txt")
    shares = np.array([[0.5], [0.25], [1], [0.5]])
    np.testing.assert_allclose(written, np.asarray(NEAR.intensities) * shares)
    assert any("differ in exposure" in line for line in map(str, export.warnings))
    # recording.json has the exposures, so the lights are read back unchanged.
    back = import_frames(read_import(tmp_path / "out"), tmp_path / "back")
    same_lights(NEAR, back.lights)
    assert [frame.exposure_us for frame in back.frames] == list(exposures.values())


def test_images_of_a_rotated_camera_are_exported_upright(tmp_path: Path) -> None:
    mounting = Mounting(rotation_deg=90, mirror=True)
    folder = session(tmp_path / "s", mounting=mounting, cfa="GRBG")
    export = prepare_export(folder, "diligent")
    export.write(tmp_path / "out")
    for name, stored in zip(("001.png", "003.png"), (lit(folder)[0], lit(folder)[3]), strict=True):
        np.testing.assert_array_equal(read_image(tmp_path / "out" / name), mounting.upright(stored))
    assert export.notes.camera.cfa == mounting.upright_cfa("GRBG", SIZE)
    back = import_frames(read_import(tmp_path / "out"), tmp_path / "back")
    assert read_source(folder).cfa == read_source(tmp_path / "back").cfa
    assert back.manifest.camera_model == Session.open(folder).manifest.camera_model


def test_repeats_are_left_out_and_reported(tmp_path: Path) -> None:
    record(tmp_path / "s", {PlannedShot("light", 0, 0, repeat, 10.0): repeat for repeat in (1, 0)})
    lights = Lights(directions=np.array([[0, 0, 1.0]]))
    export = prepare_export(tmp_path / "s", "lp", lights=lights)
    export.write(tmp_path / "out")
    np.testing.assert_array_equal(read_image(tmp_path / "out" / "L00.png"), picture(0, SIZE))
    assert any("1 repeats" in line for line in map(str, export.warnings))


@pytest.mark.parametrize("layout", ["diligent", "lp", "alicevision"])
def test_without_lights_only_exr_is_written(tmp_path: Path, layout: Layout) -> None:
    folder = session(tmp_path / "s", lights=None)
    with pytest.raises(DataError, match="no lights are known"):
        prepare_export(folder, layout)
    renamed = replace(NEAR, ids=("a", "b", "c", "d"))
    export = prepare_export(folder, layout, lights=renamed)
    assert any("by order" in line for line in map(str, export.warnings))
    assert not any(path.suffix == ".json" and "lights" in path.name for path in exr(folder))


def test_lights_with_the_names_of_led_images_belong_to_those_leds(tmp_path: Path) -> None:
    """Lights in the order of another program are matched by name, without a warning."""
    folder = session(tmp_path / "s", lights=None)
    order = [2, 0, 3, 1]
    shuffled = NEAR.distant().take(order)
    ids = tuple(f"{name}_E0.png" for name in shuffled.ids)
    export = prepare_export(folder, "diligent", lights=replace(shuffled, ids=ids))
    assert not any("order" in line for line in map(str, export.warnings))
    export.write(tmp_path / "out")
    directions = np.loadtxt(tmp_path / "out" / "light_directions.txt")
    np.testing.assert_allclose(directions, NEAR.unit_directions, atol=1e-12)
    others = replace(shuffled, ids=tuple(f"L{led}_E0.png" for led in (10, 11, 12, 13)))
    with pytest.raises(DataError, match="0 of 4 image names match a light, L00 does not"):
        prepare_export(folder, "diligent", lights=others)


def exr(folder: Path) -> tuple[Path, ...]:
    return prepare_export(folder, "exr").write(folder.parent / "exr")


def test_refused_exports(tmp_path: Path) -> None:
    with pytest.raises(MissingPathError, match="no such folder"):
        prepare_export(tmp_path / "none", "lp")
    with pytest.raises(DataError, match="is not a session"):
        prepare_export(tmp_path, "lp")
    folder = session(tmp_path / "s")
    frame = folder / "frames" / "L03_E0.tif"
    data = bytearray(frame.read_bytes())
    data[-1] ^= 1
    frame.write_bytes(data)
    with pytest.raises(DataError, match=r"L03_E0\.tif: its pixels differ"):
        prepare_export(folder, "lp").write(tmp_path / "out")
    assert not (tmp_path / "out" / "recording.json").exists(), "it must be written last"


def test_an_output_path_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for layout in ("lp", "exr"):
        with pytest.raises(StorageError, match="file"):
            prepare_export(session(tmp_path / layout), layout).write(tmp_path / "file" / "out")


def test_damaged_notes_are_refused_and_notes_of_other_images_are_not_used(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    prepare_export(folder, "lp").write(tmp_path / "out")
    notes = tmp_path / "out" / "recording.json"
    text = notes.read_text()
    notes.write_text(text.replace('"version": 1', '"version": 2'))
    with pytest.raises(DataError, match=r"recording\.json: .*version.*; restore the file"):
        read_import(tmp_path / "out")
    notes.write_text(text.replace("lights.json", "../lights.json"))
    with pytest.raises(DataError, match=r"recording\.json: .*lights_file"):
        read_import(tmp_path / "out")
    notes.write_text(text.replace("L03.png", "L33.png"))
    source = read_import(tmp_path / "out")
    assert any("L03.png: is not in recording.json" in line for line in map(str, source.warnings))
    assert import_frames(source, tmp_path / "back").manifest.camera.white_dn == 65535


def test_lights_json_of_an_lp_export_can_be_given_as_lights(tmp_path: Path) -> None:
    prepare_export(session(tmp_path / "s"), "lp").write(tmp_path / "out")
    lights = read_lights(tmp_path / "out" / "lights.json")
    assert lights.near
    assert read_source(tmp_path / "out", lights=lights).warnings == ()
