"""Import of images into sessions keeps every sample and the metadata."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    DataError,
    Labels,
    Lights,
    Session,
    StorageError,
    import_frames,
    read_image,
    read_source,
    verify_session,
    write_exr,
    write_png,
)
from acquisition.exports import prepare_export
from acquisition.imports import read_import
from acquisition.pixels import read_raw, write_tiff
from acquisition.source.image_folder import images_source
from tests.acquisition.image_bytes import by_library
from tests.real_data import DATA, needs_data

PIXELS = np.random.default_rng(8).integers(0, 65535, (12, 4, 6, 3)).astype(np.uint16)


@pytest.mark.parametrize(
    ("dtype", "bit_depth", "white"), [(np.uint8, 8, 255), (np.uint16, 16, 65535)]
)
@pytest.mark.parametrize("channels", [1, 3])
def test_samples_lights_and_camera_are_kept(
    tmp_path: Path, dtype: type, bit_depth: int, white: float, channels: int
) -> None:
    values = PIXELS if dtype is np.uint16 else PIXELS >> 8
    values = (values[..., 0] if channels == 1 else values).astype(dtype)
    (tmp_path / "in").mkdir()
    for index, pixels in enumerate(values):
        write_tiff(tmp_path / "in" / f"owl.{index}.tif", pixels)
    directions = np.stack([np.arange(12), np.zeros(12), np.full(12, 10)], axis=1)
    camera = CameraModel(np.array([[9.0, 0, 3], [0, 9, 2], [0, 0, 1]]), 6, 4, 300.0)
    source = read_source(tmp_path / "in", lights=Lights(directions=directions), camera=camera)
    done = []
    session = import_frames(
        source,
        tmp_path / "out",
        Labels(
            operator="op", object_name="owl", notes="from elsewhere", place="Rome", rights="CC0"
        ),
        on_progress=lambda *report: done.append(report),
    )
    assert session.complete
    assert verify_session(tmp_path / "out").ok
    assert done[10] == ("importing", 11, 12)
    assert session.frames[10].line.origin == "owl.10.tif"
    assert [frame.path.name for frame in session.frames][10:] == ["L10_E0.tif", "L11_E0.tif"]
    for frame, pixels in zip(session.frames, values, strict=True):
        stored = frame.read()
        assert stored.dtype == np.uint16
        np.testing.assert_array_equal(stored, pixels)
    manifest = session.manifest
    assert (manifest.camera.bit_depth, manifest.camera.white_dn) == (bit_depth, white)
    assert (manifest.operator, manifest.object, manifest.plan) == ("op", "owl", None)
    assert (manifest.place, manifest.rights) == ("Rome", "CC0")
    again = read_source(tmp_path / "out")
    assert again.lights is not None
    assert again.lights.ids == tuple(f"L{i:02d}" for i in range(12))
    np.testing.assert_array_equal(again.lights.directions, source.lights.directions)
    assert again.camera is not None
    assert again.camera.working_distance_mm == 300
    assert again.white_level == white
    assert again.warnings == ()


def test_refused_imports(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.0.exr", np.ones((4, 6), np.float32))
    with pytest.raises(DataError, match=r"a\.0\.exr: a session holds whole numbers"):
        import_frames(read_source(tmp_path), tmp_path / "out")
    assert not (tmp_path / "out").exists()
    write_png(tmp_path / "b.png", PIXELS[0])
    one = read_source(tmp_path / "b.png")
    import_frames(one, tmp_path / "out")
    with pytest.raises(DataError, match="already a session"):
        import_frames(read_source(tmp_path / "out"), tmp_path / "2")
    before = sorted(path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file())
    with pytest.raises(StorageError, match="not empty"):
        import_frames(one, tmp_path / "out")
    after = sorted(path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file())
    assert after == before


def test_mask_and_true_normals_are_imported(tmp_path: Path) -> None:
    source = replace(
        read_source(fill(tmp_path / "in")),
        mask=PIXELS[0, ..., 0] > 30000,
        normals_truth=np.random.default_rng(9).normal(size=(4, 6, 3)).astype(np.float32),
    )
    import_frames(source, tmp_path / "out")
    assert verify_session(tmp_path / "out").ok
    again = read_source(tmp_path / "out")
    assert again.mask is not None
    assert again.normals_truth is not None
    np.testing.assert_array_equal(again.mask, source.mask)
    np.testing.assert_array_equal(again.normals_truth, source.normals_truth)


def test_a_source_without_a_mask_gives_a_session_without_a_mask(tmp_path: Path) -> None:
    source = read_source(fill(tmp_path / "in"))
    import_frames(source, tmp_path / "out")
    assert not (tmp_path / "out" / "derived").exists()
    assert read_source(tmp_path / "out").mask is None


def fill(folder: Path) -> Path:
    folder.mkdir()
    for index in range(2):
        write_png(folder / f"a.{index}.png", PIXELS[index])
    return folder


@pytest.mark.parametrize("there", [False, True])
def test_a_damaged_image_leaves_no_session(tmp_path: Path, there: bool) -> None:
    (tmp_path / "in").mkdir()
    for index in range(3):
        write_png(tmp_path / "in" / f"a.{index}.png", PIXELS[index])
    data = (tmp_path / "in" / "a.2.png").read_bytes()
    (tmp_path / "in" / "a.2.png").write_bytes(data[:-40])
    source = read_source(tmp_path / "in")
    if there:
        (tmp_path / "out").mkdir()
    with pytest.raises(DataError, match=r"a\.2\.png: PNG cut short"):
        import_frames(source, tmp_path / "out")
    assert (tmp_path / "out").exists() == there
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == [
        "a.0.png",
        "a.1.png",
        "a.2.png",
    ]


def test_an_interrupted_import_leaves_an_incomplete_session(tmp_path: Path) -> None:
    def interrupt(stage: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        import_frames(read_source(fill(tmp_path / "in")), tmp_path / "out", on_progress=interrupt)
    assert caught.value.__notes__ == [
        f"{tmp_path / 'out'}: an incomplete session remains: delete it, then import again"
    ]
    session = Session.open(tmp_path / "out")
    assert not session.complete
    assert len(session.frames) == 1


def test_a_folder_with_files_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "notes.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(StorageError):
        import_frames(read_source(fill(tmp_path / "in")), tmp_path / "out")
    assert (tmp_path / "out" / "notes.txt").read_text(encoding="utf-8") == "mine"


def test_images_that_are_named_after_leds_keep_their_leds(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    for led in (0, 1, 4, 12):
        write_png(tmp_path / "in" / f"L{led:02d}_E0.png", PIXELS[led % 12])
    directions = np.array([[1.0, 0, 1], [2, 0, 1], [3, 0, 1], [4, 0, 1]])
    lights = Lights(directions=directions, ids=("L00", "L01", "L04", "L12"))
    source = read_import(tmp_path / "in", lights=replace(lights, ids=()))
    session = import_frames(source, tmp_path / "out")
    assert [frame.led for frame in session.frames] == [0, 1, 4, 12]
    assert session.lights is not None
    assert session.lights.ids == lights.ids
    # If one name has no LED, the images are numbered.
    write_png(tmp_path / "in" / "L_13_E0.png", PIXELS[0])
    files = [tmp_path / "in" / name for name in ("L00_E0.png", "L_13_E0.png")]
    counted = import_frames(images_source(tmp_path / "in", files), tmp_path / "other")
    assert [frame.led for frame in counted.frames] == [0, 1]


def test_the_exposure_that_an_image_states_is_kept(tmp_path: Path) -> None:
    for index in range(2):
        path = tmp_path / f"a.{index}.tif"
        by_library(path, PIXELS[index], ExposureTime=0.0125, Make="Acme")
    session = import_frames(read_import(tmp_path), tmp_path / "out")
    assert [frame.exposure_us for frame in session.frames] == [12_500, 12_500]
    assert session.manifest.camera.vendor == "Acme"


def lp(folder: Path, names: list[str]) -> Path:
    rows = "".join(f"{name} 0 0.{i + 1} 1\n" for i, name in enumerate(names))
    (folder / "x.lp").write_text(f"{len(names)}\n{rows}")
    return folder


@pytest.mark.parametrize(
    ("names", "refused", "warned"),
    [
        pytest.param(["a.0.png", "a.1.png"], "", False, id="by-name"),
        pytest.param(["D:\\scan\\A.0.PNG", "D:\\scan\\A.1.PNG"], "", False, id="windows"),
        pytest.param(["x.png", "y.png"], "", True, id="by-order"),
        pytest.param(["x.png", "y.png", "z.png"], "2 images for 3 lights", False, id="other-count"),
        pytest.param(["a.0.png", "y.png"], "y.png is not", False, id="in-part"),
    ],
)
def test_an_lp_matches_by_name_or_by_order_or_is_refused(
    tmp_path: Path, names: list[str], refused: str, warned: bool
) -> None:
    folder = lp(fill(tmp_path / "in"), names)
    if refused:
        with pytest.raises(DataError, match=refused):
            read_import(folder)
        return
    source = read_import(folder)
    assert any("by order" in line for line in map(str, source.warnings)) is warned
    session = import_frames(source, tmp_path / "out")
    assert session.lights is not None
    heights = session.lights.unit_directions[:, 1] / session.lights.unit_directions[:, 2]
    np.testing.assert_allclose(heights, [0.1, 0.2])


@needs_data
def test_real_diligent_captures_become_a_session(tmp_path: Path) -> None:
    folder = DATA / "diligent" / "catPNG"
    source = read_import(folder)
    source = replace(
        source, frames=source.frames[:2], lights=source.lights and source.lights.take(range(2))
    )
    session = import_frames(source, tmp_path / "out", Labels(object_name="cat"))
    assert verify_session(tmp_path / "out").ok
    for frame, original in zip(session.frames, source.frames, strict=True):
        np.testing.assert_array_equal(frame.read(), original.read())
    assert session.lights is not None
    rows = np.loadtxt(folder / "light_intensities.txt")[:2]
    np.testing.assert_array_equal(session.lights.intensities, rows)
    # An export gives the original files again.
    prepare_export(tmp_path / "out", "diligent").write(tmp_path / "again")
    for number in range(1, 3):
        name = f"{number:03d}.png"
        np.testing.assert_array_equal(
            read_image(tmp_path / "again" / name), read_image(folder / name)
        )
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "again" / "light_intensities.txt"), rows)


@needs_data
def test_a_real_raw_file_becomes_one_frame_with_its_mosaic(tmp_path: Path) -> None:
    path = DATA / "raw" / "RAW_KODAK_DC50.KDC"
    session = import_frames(
        read_source(path), tmp_path / "out", Labels(operator="op", object_name="street")
    )
    (frame,) = session.frames
    np.testing.assert_array_equal(frame.read(), read_raw(path).pixels)
    camera = session.manifest.camera
    assert (camera.cfa, camera.bit_depth, camera.channels) == ("GRBG", 14, 1)
    assert (camera.black_level_dn, camera.white_dn) == (0, 16383)
    assert frame.line.origin == "RAW_KODAK_DC50.KDC"
    assert 'cfa = "GRBG"' in (tmp_path / "out" / "session.toml").read_text()
    assert verify_session(tmp_path / "out").ok
    assert read_source(tmp_path / "out").cfa == "GRBG"


@needs_data
def test_real_captures_become_a_session(tmp_path: Path) -> None:
    source = read_source(DATA / "uw" / "buddha")
    session = import_frames(source, tmp_path / "out", Labels(operator="op", object_name="buddha"))
    assert verify_session(tmp_path / "out").ok
    assert len(session.frames) == 12
    np.testing.assert_array_equal(session.frames[10].read(), source.frames[10].read())
    assert session.frames[10].line.origin == "buddha.10.tga"
