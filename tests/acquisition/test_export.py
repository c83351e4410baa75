"""Export of sessions: content of the layouts, round trips through import, refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt
import OpenImageIO as oiio  # noqa: N813
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.io import loadmat

from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._export.caption import Caption
from acquisition._export.captioned_images import write_captioned_png
from acquisition._export.export import Layout, prepare_export
from acquisition._import.frames import import_frames, read_import
from acquisition._pixels.images import read_image, write_exr, write_png
from acquisition._plan.planned_shot import PlannedShot
from acquisition._session.camera_report import CameraReport
from acquisition._session.compact import compact_session
from acquisition._session.manifest import Manifest
from acquisition._session.session import Session
from acquisition._session.value_records import CameraModelRecord, LightsRecord
from acquisition._session.verify import verify_session
from acquisition._session.writer import SessionWriter
from acquisition._source.reader import read_source
from acquisition._storage import make_folder
from acquisition._value_files.lights import read_lights
from acquisition._values.camera_model import CameraModel
from acquisition._values.lights import Lights, led_id
from rig import Mounting

SIZE = (20, 28)
LEDS = (0, 1, 3, 4)  # 2 is dead
K = np.array([[90.0, 0, 14], [0, 90, 10], [0, 0, 1]])
NEAR = Lights(
    positions_mm=np.array([[10.0, 0, 100], [0, 20, 90], [-30, 1 / 3, 80], [0, -40, 70]]),
    intensities=np.array([[1, 2, 3], [0.1, 0.2, 0.3], [5, 5, 5], [1 / 3, 1, 1]]),
    mu=np.array([0, 1, 2, 0.5]),
    ids=tuple(map(led_id, LEDS)),
)
TEXTS = {
    "operator": "Ada L.",
    "object": "Öwl <coin> & \u2603",
    "place": "Rome, room 3",
    "notes": "two\nlines",
    "rights": "CC BY 4.0",
}


def picture(number: int, shape: tuple[int, ...], largest: int = 4095) -> npt.NDArray[np.uint16]:
    return (
        np.random.default_rng(number).integers(0, largest, shape, endpoint=True).astype(np.uint16)
    )


def session(
    folder: Path,
    *,
    lights: Lights | None = NEAR,
    channels: int = 1,
    cfa: str | None = None,
    brackets: tuple[float, ...] = (1000.0,),
    unlit: tuple[str, ...] = ("dark",),
    mounting: Mounting | None = None,
    black: float = 64.0,
    maps: bool = True,
) -> Path:
    height, width = SIZE
    rig = {"name": "r", "driver": "d", "board": "b", "protocol": "2", "firmware": "f", "leds": 5}
    upright = (mounting or Mounting()).upright_shape(SIZE)
    manifest = Manifest(
        started_utc=datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC),
        rig=None if mounting is None else {**rig, "mounting": mounting},
        camera={
            "width": width,
            "height": height,
            "channels": channels,
            "bit_depth": 12,
            "cfa": cfa,
            "black_level_dn": black,
            "white_level_dn": 4000.0,
            "vendor": "Acme",
            "serial": "17",
        },
        camera_model=CameraModelRecord.of(CameraModel(K, upright[1], upright[0], 300.0)),
        lights=None if lights is None else LightsRecord.of(lights),
        **TEXTS,
    )
    shots = [
        PlannedShot(role, None, bracket, 0, exposure)
        for role in unlit
        for bracket, exposure in enumerate(brackets)
    ]
    shots += [
        PlannedShot("light", led, bracket, 0, exposure)
        for bracket, exposure in enumerate(brackets)
        for led in LEDS
    ]
    with SessionWriter.create(folder, manifest) as writer:
        for number, shot in enumerate(shots):
            largest = 100 if shot.role != "light" else 4095
            writer.write_frame(
                shot,
                picture(number, manifest.camera.shape, largest),
                report=CameraReport(gain_db=3.0),
            )
        if maps:
            make_folder(folder / "derived" / "truth")
            mask = np.zeros(upright, np.uint8)
            mask[3:9, 4:12] = 255
            write_png(folder / "derived" / "mask.png", mask)
            write_exr(folder / "derived" / "truth" / "normals.exr", true_normals(mask > 0))
        writer.complete()
    return folder


def true_normals(mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.float32]:
    normals = np.random.default_rng(5).normal(size=(*mask.shape, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return np.where(mask[..., None], normals, 0).astype(np.float32)


def lit(folder: Path, bracket: int = 0) -> dict[int, npt.NDArray[np.uint16]]:
    """Pixels by LED."""
    return {
        frame.led: frame.read()
        for frame in Session.open(folder).frames
        if frame.led is not None and frame.bracket == bracket
    }


def same_pixels(folder: Path, other: Path) -> None:
    one, two = lit(folder), lit(other)
    assert list(one) == list(two) == list(LEDS)
    for led, pixels in one.items():
        np.testing.assert_array_equal(two[led], pixels)


def same_lights(one: Lights | None, two: Lights | None) -> None:
    assert one is not None
    assert two is not None
    assert one.ids == two.ids
    for name in ("directions", "positions_mm", "intensities", "axes", "mu"):
        mine, theirs = getattr(one, name), getattr(two, name)
        assert (mine is None) == (theirs is None), name
        if mine is not None:
            np.testing.assert_allclose(theirs, mine, rtol=0, atol=1e-15, err_msg=name)


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
@pytest.mark.parametrize("compacted", [False, True], ids=["as-recorded", "compacted"])
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


@pytest.mark.parametrize("layout", ["diligent", "lp", "alicevision"])
def test_an_export_is_read_as_the_session_was(tmp_path: Path, layout: Layout) -> None:
    """Near lights and levels are kept although the layouts cannot hold them."""
    folder = session(tmp_path / "s")
    prepare_export(folder, layout).write(tmp_path / "out")
    was, now = read_source(folder), read_source(tmp_path / "out")
    assert now.warnings == ()
    assert now.lights is not None
    assert now.lights.near
    same_lights(now.lights, replace(NEAR, ids=now.lights.ids))
    assert (now.black_level, now.white_level) == (was.black_level, was.white_level)
    assert now.camera is not None
    assert was.camera is not None
    np.testing.assert_array_equal(now.camera.K, was.camera.K)
    assert {frame.exposure_us for frame in now.frames} == {1000.0}
    assert {"recording.json", "lights.json", "camera.json"} <= {path.name for path in now.files}
    (tmp_path / "out" / "camera.json").unlink()
    (warning,) = read_source(tmp_path / "out").warnings
    assert "camera.json, which recording.json names, is missing" in str(warning)


@pytest.mark.parametrize("layout", ["diligent", "lp"])
def test_pixels_and_lights_can_be_read_from_the_files_of_the_layout_only(
    tmp_path: Path, layout: Layout
) -> None:
    """Other programs read them this way, and so does an import without our own metadata files."""
    folder = session(tmp_path / "s")
    prepare_export(folder, layout).write(tmp_path / "out")
    for name in ("recording.json", "lights.json", "camera.json"):
        (tmp_path / "out" / name).unlink()
    back = import_frames(read_import(tmp_path / "out"), tmp_path / "back")
    pixels = [frame.read() for frame in back.frames]
    np.testing.assert_array_equal(pixels, list(lit(folder).values()))
    assert back.lights is not None
    expected = NEAR.distant().unit_directions
    np.testing.assert_allclose(back.lights.unit_directions, expected, rtol=0, atol=1e-15)
    if layout == "diligent":
        np.testing.assert_array_equal(back.lights.intensities, NEAR.intensities)
        assert back.lights.ids == ("L00", "L01", "L02", "L03")
    else:
        assert back.lights.ids == NEAR.ids, "images that are named after LEDs keep their LED"
    assert [frame.line.led for frame in back.frames] == [int(i[1:]) for i in back.lights.ids]


def test_diligent_layout_is_as_its_readers_expect(tmp_path: Path) -> None:
    folder = session(tmp_path / "s")
    export = prepare_export(folder, "diligent")
    files = export.write(tmp_path / "out")
    assert sorted(files) == sorted((tmp_path / "out").iterdir())
    out = tmp_path / "out"
    names = (out / "filenames.txt").read_text().splitlines()
    assert names == ["001.png", "002.png", "003.png", "004.png"]
    for name, pixels in zip(names, lit(folder).values(), strict=True):
        np.testing.assert_array_equal(read_image(out / name), pixels)
    np.testing.assert_allclose(np.loadtxt(out / "light_directions.txt"), NEAR.unit_directions)
    np.testing.assert_array_equal(np.loadtxt(out / "light_intensities.txt"), NEAR.intensities)
    assert (out / "light_intensities.txt").read_bytes().endswith(b"\n")
    assert set(np.unique(read_image(out / "mask.png"))) == {0, 255}
    normals = loadmat(out / "Normal_gt.mat")["Normal_gt"]
    np.testing.assert_array_equal(normals, read_source(folder).normals_truth)
    assert any("positions" in line for line in map(str, export.warnings))
    assert any("black level of 64" in line for line in map(str, export.warnings))
    assert any("1 dark, ambient or flat" in line for line in map(str, export.warnings))
    assert tuple(map(str, export.warnings)) == export.notes.remarks


def test_alicevision_lights_are_text_with_y_down(tmp_path: Path) -> None:
    prepare_export(session(tmp_path / "s"), "alicevision").write(tmp_path / "out")
    lights = json.loads((tmp_path / "out" / "alicevision_lights.json").read_text())["lights"]
    assert [light["viewId"] for light in lights] == ["0", "1", "3", "4"]
    assert {light["type"] for light in lights} == {"directional"}
    assert all(isinstance(n, str) for light in lights for n in light["direction"])
    directions = np.array([[float(n) for n in light["direction"]] for light in lights])
    np.testing.assert_allclose(directions, NEAR.unit_directions * [1, -1, -1], atol=1e-15)
    strengths = np.array([[float(n) for n in light["intensity"]] for light in lights])
    np.testing.assert_array_equal(strengths, NEAR.intensities)


def test_an_lp_names_its_images(tmp_path: Path) -> None:
    prepare_export(session(tmp_path / "s"), "lp").write(tmp_path / "out")
    lines = (tmp_path / "out" / "lights.lp").read_text().splitlines()
    assert lines[0] == "4"
    assert [line.split()[0] for line in lines[1:]] == ["L00.png", "L01.png", "L03.png", "L04.png"]
    assert not any("e" in line.split(maxsplit=1)[1] for line in lines[1:]), "no exponents"


@pytest.mark.parametrize(
    ("unlit", "subtracted", "offset"),
    [
        pytest.param(("dark",), "dark frames", 0, id="dark"),
        pytest.param(("dark", "ambient"), "ambient frames", 1, id="ambient"),
        pytest.param((), "black level", None, id="level"),
    ],
)
def test_linear_values_are_proportional_to_light(
    tmp_path: Path, unlit: tuple[str, ...], subtracted: str, offset: int | None
) -> None:
    folder = session(tmp_path / "s", unlit=unlit)
    export = prepare_export(folder, "lp", values="linear")
    export.write(tmp_path / "out")
    assert export.notes.subtracted == subtracted
    assert (export.notes.camera.black_level_dn, export.notes.camera.white_dn) == (0, 65535)
    black = 64.0 if offset is None else picture(offset, SIZE, 100).astype(float)
    for led, stored in lit(folder).items():
        signal = np.clip((stored - black) / (4000 - 64), 0, 1)
        signal[stored >= 4000] = 1
        written = read_image(tmp_path / "out" / f"{led_id(led)}.png")
        assert written.dtype == np.uint16
        np.testing.assert_allclose(written, signal * 65535, atol=0.6)
    prepare_export(folder, "exr", values="linear").write(tmp_path / "exr")
    assert len(list((tmp_path / "exr").glob("*.exr"))) == 4
    stored = lit(folder)[3]
    np.testing.assert_allclose(
        read_image(tmp_path / "exr" / "L03_E0.exr"),
        (stored - black) / (4000 - 64),
        atol=1e-6,
    )


def test_an_exr_stack_has_all_frames_with_their_metadata(tmp_path: Path) -> None:
    folder = session(tmp_path / "s", brackets=(1000.0, 250.5))
    prepare_export(folder, "exr").write(tmp_path / "out")
    frames = Session.open(folder).frames
    for frame in frames:
        path = tmp_path / "out" / f"{Path(frame.line.file).stem}.exr"
        np.testing.assert_array_equal(read_image(path), frame.read().astype(np.float32))
    assert len(list((tmp_path / "out").glob("*.exr"))) == len(frames) == 10
    file = oiio.ImageInput.open(str(tmp_path / "out" / "L03_E1.exr"))
    spec = file.spec()
    file.close()
    assert spec.getattribute("DocumentName") == TEXTS["object"]
    assert spec.getattribute("Artist") == TEXTS["operator"]
    assert spec.getattribute("Copyright") == TEXTS["rights"]
    assert spec.getattribute("ImageDescription") == TEXTS["notes"]
    assert spec.getattribute("Location") == TEXTS["place"]
    assert spec.getattribute("DateTime") == "2026:01:02 03:04:05"
    assert spec.getattribute("ExposureTime") == pytest.approx(250.5e-6)
    assert spec.getattribute("sgp:led") == 3
    assert spec.getattribute("sgp:role") == "light"
    assert spec.getattribute("sgp:values") == "raw"
    assert spec.getattribute("sgp:white_level") == pytest.approx(4000)
    assert spec.getattribute("sgp:light_position_mm") == pytest.approx((-30, 1 / 3, 80))
    assert spec.getattribute("sgp:light_direction") == pytest.approx(NEAR.unit_directions[2])


def test_a_png_has_its_caption_and_gamma_1(tmp_path: Path) -> None:
    prepare_export(session(tmp_path / "s"), "lp").write(tmp_path / "out")
    with Image.open(tmp_path / "out" / "L03.png") as image:
        image.load()
        texts = {str(key): str(value) for key, value in image.text.items()}
        assert image.info["gamma"] == 1
        assert "srgb" not in image.info
    assert texts["Title"] == TEXTS["object"]
    assert texts["Author"] == TEXTS["operator"]
    assert texts["Location"] == TEXTS["place"]
    assert texts["Description"] == TEXTS["notes"]
    assert texts["Copyright"] == TEXTS["rights"]
    assert texts["Creation Time"] == "2026-01-02T03:04:05+00:00"
    assert texts["Exposure"] == "1000 us"
    assert texts["Software"].startswith("surface-geometry-processing ")
    xmp = texts["XML:com.adobe.xmp"]
    tree = ET.fromstring(xmp)
    dc = "{http://purl.org/dc/elements/1.1/}"
    li = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}li"
    for name, field in (("title", "object"), ("creator", "operator"), ("rights", "rights")):
        assert tree.findtext(f".//{dc}{name}//{li}") == TEXTS[field]
    core = "{http://iptc.org/std/Iptc4xmpCore/1.0/xmlns/}"
    assert tree.findtext(f".//{core}Location") == TEXTS["place"]
    assert tree.findtext(".//{http://ns.adobe.com/exif/1.0/}ExposureTime") == "1000000/1000000000"


@settings(deadline=None)
@given(st.text(), st.text(), st.none() | st.floats(0.001, 1e9))
def test_any_text_fits_into_a_caption(
    tmp_path_factory: pytest.TempPathFactory, title: str, notes: str, exposure_us: float | None
) -> None:
    path = tmp_path_factory.mktemp("png") / "a.png"
    caption = Caption(title, "", "", notes, "", datetime(2026, 1, 2, tzinfo=UTC), "s", exposure_us)
    pixels = picture(1, (3, 4))
    write_captioned_png(path, pixels, caption)
    np.testing.assert_array_equal(read_image(path), pixels)
    ET.fromstring(caption.xmp())


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
    manifest = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC),
        operator="",
        object="",
        camera={"width": SIZE[1], "height": SIZE[0], "bit_depth": 12},
        lights=LightsRecord.of(NEAR),
    )
    exposures = dict(zip(LEDS, (1000.0, 500.0, 2000.0, 1000.0), strict=True))
    with SessionWriter.create(tmp_path / "s", manifest) as writer:
        for led, exposure_us in exposures.items():
            writer.write_frame(PlannedShot("light", led, 0, 0, exposure_us), picture(led, SIZE))
        writer.complete()
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
    manifest = Manifest(
        started_utc=datetime(2026, 1, 2, tzinfo=UTC),
        operator="",
        object="",
        camera={"width": SIZE[1], "height": SIZE[0], "bit_depth": 12},
    )
    with SessionWriter.create(tmp_path / "s", manifest) as writer:
        for repeat in (1, 0):
            writer.write_frame(PlannedShot("light", 0, 0, repeat, 10.0), picture(repeat, SIZE))
        writer.complete()
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
