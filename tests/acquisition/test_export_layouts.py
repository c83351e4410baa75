"""Layouts of exports: what their readers expect, and values, captions and metadata."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.io import loadmat

from acquisition import Session, import_frames, read_image, read_source
from acquisition.exports import Caption, Layout, prepare_export
from acquisition.exports.captioned_images import write_captioned_png
from acquisition.imports import read_import
from acquisition.values import led_id
from tests.acquisition.exported_session import NEAR, SIZE, TEXTS, lit, picture, same_lights, session
from tests.acquisition.small_session import manifest


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


@given(st.text(), st.text(), st.none() | st.floats(0.001, 1e9))
def test_any_text_fits_into_a_caption(
    tmp_path_factory: pytest.TempPathFactory, title: str, notes: str, exposure_us: float | None
) -> None:
    path = tmp_path_factory.mktemp("png") / "a.png"
    caption = Caption(manifest((3, 4), 12, object=title, notes=notes), exposure_us)
    pixels = picture(1, (3, 4))
    write_captioned_png(path, pixels, caption)
    np.testing.assert_array_equal(read_image(path), pixels)
    ET.fromstring(caption.xmp())
