"""flat.json and its images, and the refusals of a flat that does not belong to a recording."""

import hashlib
import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    CameraModel,
    DataError,
    Flat,
    MissingPathError,
    Setup,
    read_image,
    read_source,
    write_exr,
    write_png,
)
from acquisition.source import apply_flat
from acquisition.value_files import flat_files, read_flat, write_flat
from acquisition.values import Calibrated

SHAPE = (12, 16)
CAMERA = CameraModel([[20, 0, 7.5], [0, 20, 5.5], [0, 0, 1]], 16, 12, 500.0)
TIME = datetime(2026, 3, 1, 12, 0, tzinfo=UTC)


def flat(**options):
    random = np.random.default_rng(1)
    parts = [random.uniform(0.8, 1.0, SHAPE), random.normal(1, 0.01, SHAPE)]
    setup = Setup("dome", "maker", "M2", "77", CAMERA)
    return Flat(*parts, **{"calibrated": Calibrated(TIME, setup), **options})


@pytest.fixture
def written(tmp_path):
    write_flat(tmp_path / "flat", flat(pixel_std=0.002, gradient_std=0.001, covered=0.9))
    return tmp_path / "flat"


@pytest.fixture
def source(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for i in range(3):
        write_png(folder / f"L0{i}.png", np.full(SHAPE, 700, np.uint16))
    return read_source(folder, camera=CAMERA)


def test_what_is_written_is_read(written):
    expected = flat()
    for path in (written, written / "flat.json"):
        found = read_flat(path)
        np.testing.assert_array_equal(found.smooth, expected.smooth)
        np.testing.assert_array_equal(found.pixel, expected.pixel)
        assert (found.pixel_std, found.gradient_std, found.covered) == (0.002, 0.001, 0.9)
        assert found.calibrated.time_utc == TIME
        assert found.calibrated.setup.camera_serial == "77"
        np.testing.assert_array_equal(found.calibrated.setup.intrinsics.K, CAMERA.K)
    assert [path.name for path in flat_files(written)] == ["flat.json", "smooth.exr", "pixel.exr"]


def test_flats_in_colour_and_of_a_mosaic(tmp_path):
    colours = np.random.default_rng(2).uniform(0.5, 1, (*SHAPE, 3)).astype(np.float32)
    write_flat(tmp_path / "rgb", Flat(colours, np.ones_like(colours)))
    np.testing.assert_array_equal(read_flat(tmp_path / "rgb").smooth, colours)
    write_flat(tmp_path / "mosaic", flat(cfa="GBRG"), provenance={"command": "test"})
    assert read_flat(tmp_path / "mosaic").cfa == "GBRG"


def change(folder: Path, **values):
    content = json.loads((folder / "flat.json").read_text())
    (folder / "flat.json").write_text(json.dumps(content | values))


def new_part(folder: Path, name: str, values):
    """Replace an image, and its hash in flat.json."""
    write_exr(folder / f"{name}.exr", values.astype(np.float32))
    digest = hashlib.sha256(values.astype("<f4").tobytes()).hexdigest()
    change(folder, **{name: {"file": f"{name}.exr", "pixels_sha256": digest}})


def with_nan(folder):
    values = read_image(folder / "pixel.exr").copy()
    values[3, 5] = np.nan
    new_part(folder, "pixel", values)


DAMAGED = {
    "version": (lambda f: change(f, version=2), "version 2 of sgp-flat is unknown"),
    "format": (lambda f: change(f, format="sgp-lights"), "key 'format'"),
    "unknown key": (lambda f: change(f, extra=1), "extra"),
    "another folder": (
        lambda f: change(f, smooth={"file": "../a.exr", "pixels_sha256": "0" * 64}),
        "smooth.file",
    ),
    "not JSON": (lambda f: (f / "flat.json").write_text("{"), "flat.json: "),
    "no image": (lambda f: (f / "pixel.exr").unlink(), "pixel.exr: no such file"),
    "cut short": (
        lambda f: (f / "smooth.exr").write_bytes((f / "smooth.exr").read_bytes()[:500]),
        "smooth.exr: ",
    ),
    "another image": (
        lambda f: write_exr(f / "pixel.exr", np.ones(SHAPE, np.float32)),
        "pixel.exr: its pixels differ from those that flat.json names",
    ),
    "NaN": (with_nan, "the pixel part of a flat is nan at pixel 5,3: numbers"),
    "zero": (
        lambda f: new_part(f, "smooth", np.zeros(SHAPE)),
        "the smooth part of a flat is 0.0 at pixel 0,0",
    ),
    "two shapes": (
        lambda f: new_part(f, "smooth", np.ones((5, 16))),
        "have the shapes (5, 16) and (12, 16)",
    ),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_flat_gets_one_line(written, name):
    damage, message = DAMAGED[name]
    damage(written)
    with pytest.raises((DataError, MissingPathError), match=re.escape(message)) as caught:
        read_flat(written)
    assert str(written) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_flat_with_more_pixels_than_allowed_is_refused(written):
    with pytest.raises(DataError, match="pixels"):
        read_flat(written, max_pixels=100)


def test_a_folder_without_a_flat(tmp_path):
    with pytest.raises(MissingPathError, match=r"flat\.json: no such file"):
        read_flat(tmp_path)


OTHER_LENS = replace(CAMERA, K=CAMERA.K * [[1.02], [1.02], [1]])
CASES = {
    "the same": (flat(), None),
    "unknown camera": (flat(calibrated=Calibrated()), None),
    "another lens": (
        flat(calibrated=Calibrated(TIME, Setup(intrinsics=OTHER_LENS))),
        "another camera or lens: .*calibrate a flat with the camera of these images",
    ),
    "another distance": (
        flat(
            calibrated=Calibrated(TIME, Setup(intrinsics=replace(CAMERA, working_distance_mm=600)))
        ),
        "working distance 600 mm, now 500 mm",
    ),
    "another size": (
        Flat(np.ones((6, 8)), np.ones((6, 8))),
        "the flat has 8 x 6 pixels, the frames have 16 x 12 pixels",
    ),
    "colours": (
        Flat(np.ones((*SHAPE, 3)), np.ones((*SHAPE, 3))),
        "the flat has 16 x 12 pixels in colour",
    ),
    "a mosaic": (flat(cfa="RGGB"), "the flat has the filter pattern RGGB, the frames have none"),
}


@pytest.mark.parametrize("name", CASES)
def test_a_flat_of_another_camera_or_size_is_refused(source, name):
    given, message = CASES[name]
    if message is None:
        applied = apply_flat(source, given)
        assert applied.flat is given
        with pytest.raises(DataError, match="has a flat already"):
            apply_flat(applied, given)
        return
    with pytest.raises(DataError, match=message):
        apply_flat(source, given)


def test_another_camera_of_the_same_model_is_refused(source):
    other = replace(source, setup=Setup(camera_model="M2", camera_serial="78"))
    with pytest.raises(DataError, match="serial number 77, now 78"):
        apply_flat(other, flat())
