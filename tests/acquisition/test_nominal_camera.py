"""The camera of a recording from the focal length that its images state."""

from __future__ import annotations

import io
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from acquisition import CameraModel, crop, downscale, import_frames, read_source
from acquisition.exports import prepare_export
from acquisition.imports import read_import
from acquisition.pixels import image_facts
from acquisition.source import source_setup
from tests.acquisition.dng_file import Tag, directory, dng, tag
from tests.acquisition.image_bytes import chunk
from tests.cases import cases

SIZE = (60, 40)
TAG = {
    "width": 256, "height": 257, "orientation": 274, "focal": 37386, "x_px": 40962, "y_px": 40963,
    "changed": 306, "taken": 36867, "x_res": 41486, "y_res": 41487, "unit": 41488,
    "zoom": 41988, "film": 41989,
}  # fmt: skip
RATIONAL = ("focal", "x_res", "y_res", "zoom")
YEAR = ("changed", "taken")
# 60 x 40 pixels of a sensor of 36 x 24 mm: 5/3 pixels on a millimetre.
FULL = {"focal": 50, "x_res": 5 / 3 * 25.4, "unit": 2, "x_px": 60, "y_px": 40}
FILM = {"focal": 25, "film": 75, "x_px": 60, "y_px": 40}


def entries(stated: dict[str, float]) -> list[Tag]:
    return [
        tag(TAG[name], 5, (round(value * 30000), 30000))
        if name in RATIONAL
        else tag(TAG[name], 2, f"{value}:02:03 04:05:06\0".encode())
        if name in YEAR
        else tag(TAG[name], 3, (int(value),))
        for name, value in stated.items()
    ]


def exif(**stated: float) -> bytes:
    """Return an Exif block of these tags, of which the first page has those below 307."""
    first = entries({name: value for name, value in stated.items() if TAG[name] < 307})
    inner = entries({name: value for name, value in stated.items() if TAG[name] > 307})
    begin = 8 + len(directory([*first, tag(34665, 4, (0,))], 8))
    main = directory([*first, tag(34665, 4, (begin,))], 8)
    return b"II*\0\x08\0\0\0" + main + directory(inner, begin)


def picture(size: tuple[int, int]) -> Image.Image:
    grey = np.random.default_rng(1).integers(20, 200, size[::-1], np.uint8)
    return Image.fromarray(grey)


def write_jpeg(path: Path, size: tuple[int, int] = SIZE, **stated: float) -> None:
    picture(size).save(path, exif=b"Exif\0\0" + exif(**stated))


def write_png(path: Path, size: tuple[int, int] = SIZE, **stated: float) -> None:
    out = io.BytesIO()
    picture(size).save(out, "png")
    path.write_bytes(out.getvalue()[:33] + chunk(b"eXIf", exif(**stated)) + out.getvalue()[33:])


def write_tiff(path: Path, size: tuple[int, int] = SIZE, **stated: float) -> None:
    tags: list[Any] = []
    for name, value in stated.items():
        rational = (round(value * 30000), 30000)
        tag = TAG[name]
        tags.append(
            (tag, "2I", 1, rational, True) if name in RATIONAL else (tag, "H", 1, value, True)
        )
    tifffile.imwrite(path, np.array(picture(size)), extratags=tags)


def write_xmp(path: Path, size: tuple[int, int] = SIZE, **stated: float) -> None:
    names = {
        "focal": "FocalLength", "x_px": "PixelXDimension", "y_px": "PixelYDimension",
        "x_res": "FocalPlaneXResolution", "unit": "FocalPlaneResolutionUnit",
        "film": "FocalLengthIn35mmFilm",
    }  # fmt: skip
    rows = " ".join(f'exif:{names[name]}="{value}"' for name, value in stated.items())
    packet = f"<x:xmpmeta><rdf:Description {rows}/></x:xmpmeta>"
    picture(size).save(path, xmp=packet.encode())


WRITERS = {".jpg": write_jpeg, ".png": write_png, ".tif": write_tiff, ".xmp.jpg": write_xmp}


def record(folder: Path, *images: dict[str, Any], suffix: str = ".jpg") -> Path:
    """Write images that state the given tags, with a ``size`` of their own if it is given."""
    for number, stated in enumerate(images):
        WRITERS[suffix](folder / f"a.{number}{suffix}", **stated)
    return folder


def codes(source: Any) -> list[str]:
    return [notice.code for notice in source.warnings if notice.code.startswith("camera")]


@cases(
    ("stated", "focal_px"),
    {
        "the samples of the sensor": ({"focal": 50, "x_res": 42.0, "unit": 2}, 50 * 42 / 25.4),
        "borders": ({**FULL, "x_px": 62, "y_px": 41}, 250 / 3),
        "film": ({"focal": 50, "film": 75}, 75 * 60 / 36),
        "cropped": ({**FULL, "x_px": 90, "y_px": 60}, None),
    },
)
def test_camera_raw(tmp_path: Path, stated: dict[str, float], focal_px: float | None) -> None:
    """Samples of the sensor are never scaled; a few at its border are not part of the image."""
    pixels = np.full((40, 60), 700, np.uint16)
    for name in ("a.0.dng", "a.1.dng"):
        (tmp_path / name).write_bytes(dng(pixels, other=entries(stated)))
    camera = read_source(tmp_path).camera
    if focal_px is None:
        assert camera is None
    else:
        assert camera is not None
        assert camera.focal_px == pytest.approx(focal_px, rel=1e-4)


DIAGONAL = math.hypot(36, 24)


@pytest.mark.parametrize("suffix", WRITERS)
@cases(
    ("stated", "focal_px"),
    {
        "size of the pixels": (FULL, 50 * 60 / 36),
        "35 mm film": (FILM, 75 * 60 / 36),
    },
)
def test_the_focal_length_in_every_format(
    tmp_path: Path, stated: dict[str, float], focal_px: float, suffix: str
) -> None:
    source = read_source(record(tmp_path, stated, stated, suffix=suffix))
    camera = source.camera
    assert camera is not None
    assert (
        pytest.approx(np.array([[focal_px, 0, 29.5], [0, focal_px, 19.5], [0, 0, 1]]), rel=1e-5)
        == camera.K
    )
    assert (camera.size, camera.working_distance_mm) == ((40, 60), None)
    assert not camera.distortion.any()
    assert source.camera_nominal
    (notice,) = (one for one in source.warnings if one.code == "camera-from-exif")
    assert f"focal length of {focal_px:.0f} px" in notice.text
    assert "calibrated camera is more accurate" in notice.text


@cases(
    ("stated", "focal_px"),
    {
        "pixels per cm": ({**FULL, "x_res": 50 / 3, "unit": 3}, 250 / 3),
        "pixels per mm": ({**FULL, "x_res": 5 / 3, "unit": 4}, 250 / 3),
        "pixels per inch by default": (
            {name: value for name, value in FULL.items() if name != "unit"}, 250 / 3
        ),
        "both agree": ({**FULL, "film": 50}, 250 / 3),
        "rows by another rounding": ({**FULL, "y_res": 1.002 * FULL["x_res"]}, 250 / 3),
        "no unit, but film": ({**FULL, "unit": 1, "film": 50}, 250 / 3),
        "diagonal of 4:3": (
            {**FILM, "size": (60, 45), "y_px": 45}, 75 * math.hypot(60, 45) / DIAGONAL
        ),
        "half the size": ({**FULL, "size": (30, 20)}, 125 / 3),
        "a third, rounded": ({**FULL, "x_px": 200, "y_px": 133}, 50 * 5 / 3 * 60 / 200),
        "turned by a quarter": ({**FULL, "size": (40, 60)}, 250 / 3),
        "orientation tag": ({**FULL, "orientation": 6}, 250 / 3),
        "size in the first page": (
            {"focal": 50, "x_res": FULL["x_res"], "width": 120, "height": 80}, 125 / 3
        ),
        "no digital zoom": ({**FULL, "zoom": 1}, 250 / 3),
    },
)  # fmt: skip
def test_the_focal_length_by_what_is_stated(
    tmp_path: Path, stated: dict[str, Any], focal_px: float
) -> None:
    source = read_source(record(tmp_path, stated, stated))
    assert codes(source) == ["camera-from-exif"]
    assert source.camera is not None
    assert source.camera.focal_px == pytest.approx(focal_px, rel=3e-3)
    assert source.camera.size == source.size


@cases(
    ("images", "severity", "says"),
    {
        "another zoom": (
            (FULL, {**FULL, "focal": 35}), "warning", r"a\.1\.jpg .* 58 px .*a\.0\.jpg one of 83 px"
        ),
        "one states nothing": ((FULL, {}), "info", r"a\.1\.jpg does not state the size"),
        "one states no lens": (
            (FULL, {"x_px": 60, "y_px": 40}), "info", r"a\.1\.jpg states no focal length"
        ),
        "cropped": (
            ({**FULL, "x_px": 90},) * 2, "info", "90 x 40 pixels and has 60 x 40, as after"
        ),
        "size not stated": (
            ({"focal": 50, "x_res": 42.0},) * 2, "info", "with which it was taken"
        ),
        "cropped, with the size after that": (
            ({**FULL, "film": 80},) * 2, "info", r"contradicts itself, as after cropping: 83 px"
        ),
        "digital zoom": (({**FULL, "zoom": 2},) * 2, "info", "enlarged 2 times"),
        "no sensor is so large": (
            ({**FULL, "x_res": 2.0},) * 2, "info", "sensor with a diagonal of 916 mm"
        ),
    },
)  # fmt: skip
def test_what_gives_no_camera_is_named(
    tmp_path: Path, images: tuple[dict[str, Any], ...], severity: str, says: str
) -> None:
    source = read_source(record(tmp_path, *images))
    assert (source.camera, source.camera_nominal) == (None, False)
    (notice,) = (one for one in source.warnings if one.code == "camera-not-from-exif")
    assert notice.severity == severity
    assert re.search(says, notice.text), notice.text


@cases(
    "stated",
    {
        "nothing": {},
        "a focal length only": {"focal": 50, "x_px": 60, "y_px": 40},
        "no lens": {**FULL, "focal": 0},
        "a resolution without a focal length": {"x_res": 42.0, "unit": 2},
        "pixels that are not square": {**FULL, "y_res": 2 * FULL["x_res"]},
        "unknown film": {"focal": 50, "film": 0},
        "no unit": {**FULL, "unit": 1},
    },
)
def test_what_states_no_focal_length_in_pixels_says_nothing(
    tmp_path: Path, stated: dict[str, float]
) -> None:
    source = read_source(record(tmp_path, stated, stated))
    assert source.camera is None
    assert codes(source) == []


@cases(
    ("stated", "said"),
    {
        "as taken": ({**FULL, "changed": 2026}, False),
        "changed": ({**FULL, "changed": 2027}, True),
        "changed, and film agrees": ({**FULL, "film": 50, "changed": 2027}, False),
        "changed, and scaled": ({**FULL, "size": (30, 20), "changed": 2027}, False),
    },
)
def test_files_that_a_program_changed(tmp_path: Path, stated: dict[str, Any], said: bool) -> None:
    source = read_source(record(tmp_path, {**stated, "taken": 2026}))
    (notice,) = (one for one in source.warnings if one.code == "camera-from-exif")
    assert ("if the program that changed the files did not crop" in notice.text) == said


def test_size_of_the_page_of_a_tiff_is_not_that_of_the_shot(tmp_path: Path) -> None:
    write_tiff(tmp_path / "a.tif", focal=50, x_res=42.0)
    assert image_facts(tmp_path / "a.tif").shot.lens.size is None


def test_a_given_camera_replaces_that_of_the_metadata(tmp_path: Path) -> None:
    given = CameraModel(np.array([[90.0, 0, 30], [0, 90, 20], [0, 0, 1]]), 60, 40, 500)
    for images in ((FULL, FULL), (FULL, {**FULL, "focal": 35})):
        source = read_source(record(tmp_path, *images), camera=given)
        assert source.camera is given
        assert not source.camera_nominal
        assert codes(source) == []


def test_a_region_at_lower_resolution(tmp_path: Path) -> None:
    source = downscale(crop(read_source(record(tmp_path, FULL, FULL)), 10, 4, 40, 30), 2)
    assert source.camera is not None
    assert source.camera_nominal
    assert source.camera.K[:2, 2] == pytest.approx([(19.5 - 0.5) / 2, (15.5 - 0.5) / 2])


def test_it_is_not_compared_with_calibrated_cameras(tmp_path: Path) -> None:
    assert source_setup(read_source(record(tmp_path, FULL, FULL))).intrinsics is None


def test_an_imported_session_keeps_the_focal_length_as_metadata(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    source = read_import(record(tmp_path / "images", FULL, FULL))
    session = import_frames(source, tmp_path / "session")
    assert session.camera_model is None
    written = prepare_export(tmp_path / "session", "exr").write(tmp_path / "export")
    assert "camera.json" not in [path.name for path in written]
    again = read_source(tmp_path / "session")
    assert again.camera_nominal
    assert again.camera is not None
    assert again.camera.focal_px == pytest.approx(250 / 3, rel=1e-5)
    assert codes(again) == ["camera-from-exif"]
