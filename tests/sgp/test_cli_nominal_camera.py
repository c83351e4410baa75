"""A camera from the focal length in Exif, where a command needs one and none is given."""

import json

import numpy as np
import pytest
import tifffile

from acquisition import CameraModel, Lights, angle_deg, read_image, write_lights, write_png
from processing import read_normals
from processing.images.viewing_rays import Parallel
from tests.cases import cases

SIZE = (44, 48)
PIXEL_MM = 2.0
FOCAL_PX = 110.0
CAMERA = CameraModel(
    np.array([[FOCAL_PX, 0, 23.5], [0, FOCAL_PX, 21.5], [0, 0, 1]]), 48, 44, FOCAL_PX * PIXEL_MM
)
RADIUS, CENTRE_MM = 55.0, -10.0
COUNT = 16


def cap():
    """Return the points of a ball in perspective."""
    rays = CAMERA.pixel_rays()
    eye = CAMERA.centre_mm - [0, 0, CENTRE_MM]
    a, b = (rays**2).sum(axis=-1), rays @ eye
    root = np.maximum(b**2 - a * (eye @ eye - RADIUS**2), 0)
    return CAMERA.centre_mm + ((-b - np.sqrt(root)) / a)[..., None] * rays


POINTS = cap()
ACROSS, UP, _ = np.moveaxis(Parallel(PIXEL_MM, SIZE, (23.5, 21.5)).points_at(0.0), 2, 0)
MASK = ACROSS**2 + UP**2 < 36**2
KNOWN = ACROSS**2 + UP**2 < 32**2
NORMALS = (POINTS - [0, 0, CENTRE_MM]) / RADIUS


def panel():
    turn = np.arange(COUNT) * 2 * np.pi / COUNT
    away = np.resize([90.0, 170.0], COUNT)
    places = np.stack([away * np.cos(turn), away * np.sin(turn), np.full(COUNT, 220.0)], 1)
    return Lights(positions_mm=places, ids=tuple(f"cap.{i:02d}" for i in range(COUNT)))


def exif(focal_mm=50):
    """Return tags of a lens of so many mm, before a sensor on which 50 mm are FOCAL_PX."""
    resolution = (round(FOCAL_PX / 50 * 25400), 1000)
    return [
        (37386, "2I", 1, (focal_mm, 1), True), (41486, "2I", 1, resolution, True),
        (41488, "H", 1, 2, True), (40962, "H", 1, 48, True), (40963, "H", 1, 44, True),
    ]  # fmt: skip


def write_images(folder, tags):
    folder.mkdir()
    lights = panel()
    shading = np.maximum((lights.vectors_at(POINTS) * NORMALS).sum(axis=-1), 0)
    shading *= 0.6 / shading[:, MASK].max()
    rng = np.random.default_rng(3)
    for k, (name, image) in enumerate(zip(lights.ids, shading, strict=True)):
        noisy = np.where(MASK, image * rng.normal(1, 0.003, SIZE), 0)
        pixels = np.rint(65535 * noisy).astype(np.uint16)
        tifffile.imwrite(folder / f"{name}.tif", pixels, extratags=tags[k])
    write_png(folder / "mask.png", (255 * MASK).astype(np.uint8))
    return folder


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("cap")
    write_lights(place / "lights.json", panel())
    write_images(place / "exif", [exif()] * COUNT)
    write_images(place / "plain", [[]] * COUNT)
    write_images(place / "zoomed", [exif()] * 5 + [exif(35)] * (COUNT - 5))
    camera = {"format": "sgp-camera", "version": 1, "K": CAMERA.K.tolist(), "width": 48,
              "height": 44, "distortion": [0.0] * 5, "working_distance_mm": 220.0}  # fmt: skip
    (place / "camera.json").write_text(json.dumps(camera), encoding="utf-8")
    return place


def words(place, name, command="normals"):
    return (command, place / name, "--lights", place / "lights.json")


def error_deg(out):
    return angle_deg(read_normals(out).normal_map.normals, NORMALS)[KNOWN].mean()


def test_near_lights_with_the_size_of_a_pixel(sgp, place, tmp_path):
    """The rays are those of the lens; without its focal length they are parallel."""
    scale = ("--pixel-mm", PIXEL_MM, "--json")
    answer = sgp(*words(place, "exif"), *scale, "--out", tmp_path / "exif").ok()
    assert answer.codes().count("camera-from-exif") == 1
    height = answer.figures()["mean_height_mm"]
    assert height == pytest.approx(POINTS[MASK][:, 2].mean(), abs=0.5)
    assert error_deg(tmp_path / "exif") < 0.3
    sgp(*words(place, "plain"), *scale, "--out", tmp_path / "plain").ok()
    assert error_deg(tmp_path / "plain") > 2 * error_deg(tmp_path / "exif")
    record = json.loads((tmp_path / "exif" / "normals.json").read_text(encoding="utf-8"))
    (stated,) = (one for one in record["notices"] if one["code"] == "camera-from-exif")
    assert "focal length of 110 px (50 mm, pixels of 454.5 um, Exif)" in stated["text"]


@pytest.mark.slow
def test_a_given_camera_has_priority(sgp, place, tmp_path):
    given = ("--camera", place / "camera.json", "--out", tmp_path / "out", "--json")
    for name in ("exif", "zoomed"):
        answer = sgp(*words(place, name), *given, "--force").ok()
        assert not [code for code in answer.codes() if "exif" in code]
        assert error_deg(tmp_path / "out") < 0.3


@cases(
    ("name", "options", "text"),
    {
        "no scale": ("exif", (), "give a camera with a working distance, or the size of a pixel"),
        "two zooms, no scale": ("zoomed", (), "give a camera with a working distance"),
    },
)
def test_what_exif_does_not_state_is_one_line(sgp, place, tmp_path, name, options, text):
    answer = sgp(*words(place, name), *options, "--out", tmp_path / "out")
    assert text in answer.error_line(4)
    assert not (tmp_path / "out").exists()


def test_images_of_two_zooms_are_named(sgp, place, tmp_path):
    answer = sgp(*words(place, "zoomed"), "--pixel-mm", PIXEL_MM, "--out", tmp_path / "o").ok()
    assert "warning: " in answer.err
    assert "cap.05.tif states a focal length of 77 px" in answer.err


@cases("command", {"intensities": "intensities", "flat": "flat"})
def test_calibrations_need_a_calibrated_camera(sgp, place, tmp_path, command):
    out = tmp_path / ("out.json" if command == "intensities" else "out")
    words = ("calibrate", command, place / "exif", "--lights", place / "lights.json")
    line = sgp(*words, "--out", out).error_line(4)
    assert "the camera of these images is not calibrated" in line


def test_a_surface_in_perspective(sgp, place, tmp_path):
    out = tmp_path / "run"
    sgp(*words(place, "exif", "run"), "--pixel-mm", PIXEL_MM, "--out", out).ok()
    depth = read_image(out / "surface" / "depth.exr")
    true = CAMERA.centre_mm[2] - POINTS[..., 2]
    assert np.abs(depth - true)[KNOWN].max() < 1.0
