"""Lights with positions on the command line: views, heights that cannot be, and strengths."""

import json
from dataclasses import replace

import numpy as np
import pytest

from acquisition import Lights, angle_deg, read_image, read_lights, write_lights, write_png
from processing import read_normals
from processing.images.viewing_rays import Parallel

SIZE = (44, 48)
PIXEL_MM = 2.0
VIEW = Parallel(PIXEL_MM, SIZE, ((SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2))
ACROSS, UP, _ = np.moveaxis(VIEW.points_at(0.0), 2, 0)
MASK = ACROSS**2 + UP**2 < 38**2
RADIUS = 55.0
# A cap of a ball whose rim is 8 mm above the working plane.
HEIGHT = np.sqrt(np.maximum(RADIUS**2 - ACROSS**2 - UP**2, 0))
HEIGHT += 8.0 - HEIGHT[MASK].min()
MEAN = HEIGHT[MASK].mean()
NORMALS = VIEW.points_at(-HEIGHT) - [0, 0, HEIGHT[MASK].max() - RADIUS]
COUNT = 16


def panel(height, away=(90.0, 170.0)):
    """Return LEDs in rings that shine straight down."""
    turn = np.arange(COUNT) * 2 * np.pi / COUNT
    away = np.resize(away, COUNT)
    places = np.stack([away * np.cos(turn), away * np.sin(turn), np.full(COUNT, height)], 1)
    names = tuple(f"cap.{i:02d}" for i in range(COUNT))
    return Lights(
        positions_mm=places, axes=np.tile([0, 0, -1.0], (COUNT, 1)), mu=np.ones(COUNT), ids=names
    )


def write_images(folder, heights, normals, lights):
    """Write images of an object, with 0.3 % noise, and its mask."""
    folder.mkdir()
    normals = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    vectors = lights.vectors_at(VIEW.points_at(-heights))
    shading = np.maximum((vectors * normals).sum(axis=-1), 0)
    shading *= 0.6 / shading[:, MASK].max()
    rng = np.random.default_rng(3)
    for name, image in zip(lights.ids, shading, strict=True):
        noisy = np.where(MASK, image * rng.normal(1, 0.003, SIZE), 0)
        write_png(folder / f"{name}.png", np.rint(65535 * noisy).astype(np.uint16))
    write_png(folder / "mask.png", (255 * MASK).astype(np.uint8))
    write_lights(folder.parent / "lights.json", lights)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return images of the cap, seen by a telecentric lens, with the lights of the panel."""
    place = tmp_path_factory.mktemp("cap")
    write_images(place / "images", HEIGHT, NORMALS, panel(220.0))
    K = [[300.0, 0, 23.5], [0, 300, 21.5], [0, 0, 1]]
    camera = {"format": "sgp-camera", "version": 1, "K": K, "distortion": [0.0] * 5}
    camera |= {"width": SIZE[1], "height": SIZE[0]}
    (place / "no-distance.json").write_text(json.dumps(camera), encoding="utf-8")
    camera["working_distance_mm"] = 600.0
    (place / "camera.json").write_text(json.dumps(camera), encoding="utf-8")
    return place


def words(folder, command, name="images"):
    return (command, folder / name, "--lights", folder / "lights.json")


REFUSED = {
    "no scale": ((), 4, "no scale: give a camera with a working distance, or the size of a pixel"),
    "no distance": (("--camera", "no-distance.json"), 4, "give the camera its working distance"),
    "two scales": (("--camera", "camera.json", "--pixel-mm", 2), 4, "exclude each other"),
    "above the lights": (("--pixel-mm", 2, "--height-mm", 300), 4, "behind lights or camera: give"),
    "below all": (("--pixel-mm", 2, "--height-mm", -900), 4, "a height of -900 mm puts the object"),
    "two heights": (("--pixel-mm", 2, "--height-mm", 3, "--rests-on-plane"), 4, "give one of them"),
    "no near light": (("--distant", "--height-mm", 3), 4, "a height matters only under lights"),
    "three lights, strengths": (
        ("--pixel-mm", 2, "--semi-calibrated", "--exclude", "3-15"), 5, "fewer than 4"
    ),
}  # fmt: skip


def test_what_near_lights_cannot_do_is_one_line(sgp, folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    for name, (options, code, text) in REFUSED.items():
        answer = sgp(*words(folder, "normals"), *options, "--out", tmp_path / "out")
        assert text in answer.error_line(code), name
        assert not (tmp_path / "out").exists()


def test_a_height_that_puts_a_part_behind_the_lights_is_one_line(sgp, tmp_path):
    """The LEDs are at 100 mm, and the upper end of the slope is 34 mm higher than its middle."""
    write_images(tmp_path / "slope", 70 + 0.9 * ACROSS, np.array([-0.9, 0, 1]), panel(100.0, 140.0))
    answer = sgp(
        *words(tmp_path, "normals", "slope"), "--pixel-mm", 2, "--height-mm", 80,
        "--out", tmp_path / "out",
    )  # fmt: skip
    assert "of the object behind the lights: fewer than 3 of them" in answer.error_line(5)
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def known():
    return MASK & (ACROSS**2 + UP**2 < 34**2)


@pytest.mark.slow
def test_a_telecentric_lens_needs_the_size_of_a_pixel_only(sgp, folder, tmp_path, known):
    out = tmp_path / "out"
    answer = sgp(*words(folder, "run"), "--pixel-mm", PIXEL_MM, "--out", out, "--json").ok()
    figures = json.loads(answer.out)["metrics"]["normals"]
    assert figures["mean_height_mm"] == pytest.approx(MEAN, abs=0.5)
    height = read_image(out / "surface" / "height.exr")
    assert np.abs(height - HEIGHT)[known].max() < 0.8
    # A part of the images at half of the resolution is at the same place.
    sgp(
        *words(folder, "normals"), "--pixel-mm", PIXEL_MM, "--crop", "4,6,42,36", "--downscale", 2,
        "--out", tmp_path / "part", "--json",
    ).ok()  # fmt: skip
    whole = read_normals(out / "normals").normal_map.normals
    reduced = read_normals(tmp_path / "part").normal_map
    blocks = whole[6:42, 4:46].reshape(18, 2, 21, 2, 3).mean(axis=(1, 3))
    assert angle_deg(reduced.normals, blocks)[reduced.mask].mean() < 0.5


def test_strengths_of_near_lights_are_found_with_the_height(sgp, folder, tmp_path, known):
    given = read_lights(folder / "lights.json")
    factors = np.random.default_rng(4).uniform(0.7, 1.4, COUNT)
    wrong = replace(given, intensities=given.intensities / factors[:, None])
    write_lights(tmp_path / "wrong.json", wrong)
    found = sgp(
        "normals", folder / "images", "--lights", tmp_path / "wrong.json", "--pixel-mm", PIXEL_MM,
        "--semi-calibrated", "--out", tmp_path / "out", "--json",
    ).ok()  # fmt: skip
    assert json.loads(found.out)["metrics"]["mean_height_mm"] == pytest.approx(MEAN, abs=5)
    strengths = read_lights(tmp_path / "out" / "lights.json").intensities
    assert np.std(np.log(strengths[:, 0] / given.intensities[:, 0])) < 0.03
    normals = read_normals(tmp_path / "out").normal_map.normals
    assert angle_deg(normals, NORMALS)[known].mean() < 0.7
