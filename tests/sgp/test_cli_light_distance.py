"""`--light-distance-mm`: the lights of a dome, whose list has only directions."""

import json

import numpy as np
import pytest

from acquisition import Lights, angle_deg, read_image, read_lights, write_lights, write_png
from processing import read_normals
from processing.images.viewing_rays import Parallel
from tests.cases import cases

SIZE = (60, 72)
PIXEL_MM = 2.5
DISTANCE = 420.0
VIEW = Parallel(PIXEL_MM, SIZE, ((SIZE[1] - 1) / 2, (SIZE[0] - 1) / 2))
ACROSS, UP, _ = np.moveaxis(VIEW.points_at(0.0), 2, 0)
MASK = (ACROSS / 82) ** 2 + (UP / 68) ** 2 < 1
KNOWN = (ACROSS / 78) ** 2 + (UP / 64) ** 2 < 1
# A low relief whose mean height is not 0.
HEIGHT = 6 + 2 * np.sin(ACROSS / 14) * np.cos(UP / 17)
SLOPES = (
    np.cos(ACROSS / 14) * np.cos(UP / 17) / 7,
    -2 * np.sin(ACROSS / 14) * np.sin(UP / 17) / 17,
)
NORMALS = np.dstack([-SLOPES[0], -SLOPES[1], np.ones(SIZE)])
NORMALS /= np.linalg.norm(NORMALS, axis=-1, keepdims=True)


def dome():
    """Return the directions of three rings."""
    rows = [(np.radians(e), 2 * np.pi * (i + 0.3) / n) for n, e in ((9, 30), (7, 50), (5, 70))
            for i in range(n)]  # fmt: skip
    high, turn = np.array(rows).T
    toward = [np.cos(high) * np.cos(turn), np.cos(high) * np.sin(turn), np.sin(high)]
    return Lights(directions=np.stack(toward, 1), ids=tuple(f"d.{i:02d}" for i in range(len(high))))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return images of the relief under the dome, with 0.3 % noise, and the list of directions."""
    place = tmp_path_factory.mktemp("dome")
    lights = dome()
    near = Lights(positions_mm=DISTANCE * lights.unit_directions, ids=lights.ids)
    vectors = near.vectors_at(VIEW.points_at(-HEIGHT))
    shading = np.maximum((vectors * NORMALS).sum(axis=-1), 0) * (0.6 + 0.2 * np.cos(UP / 9))
    shading *= 0.8 / shading[:, MASK].max()
    rng = np.random.default_rng(5)
    for name, image in zip(lights.ids, shading, strict=True):
        noisy = np.where(MASK, image * rng.normal(1, 0.003, SIZE), 0)
        write_png(place / f"{name}.png", np.rint(65535 * noisy).astype(np.uint16))
    write_png(place / "mask.png", (255 * MASK).astype(np.uint8))
    rows = [f"{name}.png {x} {y} {z}" for name, (x, y, z) in
            zip(lights.ids, lights.unit_directions, strict=True)]  # fmt: skip
    text = "\n".join([str(len(rows)), *rows])
    (place / "dome.lp").write_text(text + "\n", encoding="utf-8")
    write_lights(place.parent / "near.json", near)
    return place


def words(folder, *options):
    return ("normals", folder, "--method", "cauchy", "--pixel-mm", PIXEL_MM, *options)


def test_a_stated_distance_makes_the_lights_near(sgp, folder, tmp_path):
    """The directions alone bend the normals by more than 5 degrees."""
    out = tmp_path / "out"
    given = ("--light-distance-mm", DISTANCE, "--out", out, "--json")
    metrics = sgp(*words(folder), *given).figures()
    assert metrics["lights"] == "near"
    assert metrics["light_distance_mm"] == DISTANCE
    assert metrics["mean_height_mm"] == pytest.approx(HEIGHT[MASK].mean(), abs=2.5)
    found = read_normals(out).normal_map.normals
    assert angle_deg(found, NORMALS)[KNOWN].mean() < 0.5
    sgp(*words(folder), "--out", tmp_path / "far").ok()
    distant = read_normals(tmp_path / "far").normal_map.normals
    assert angle_deg(distant, NORMALS)[KNOWN].mean() > 5
    record = json.loads((out / "normals.json").read_text(encoding="utf-8"))
    assert record["parameters"]["light_distance_mm"] == DISTANCE
    # The lights of the result give the same normals again.
    lights = read_lights(out / "lights.json")
    assert np.allclose(np.linalg.norm(lights.positions_mm, axis=1), DISTANCE)
    sgp(*words(folder), "--lights", out / "lights.json", "--out", tmp_path / "again").ok()
    again = read_normals(tmp_path / "again").normal_map.normals
    assert angle_deg(again, found)[KNOWN].max() < 1e-3


@pytest.mark.slow
def test_the_distance_is_from_the_middle_of_the_complete_images(sgp, folder, tmp_path):
    """A region at half of the resolution has the same lights and nearly the same normals."""
    given = ("--light-distance-mm", DISTANCE)
    sgp(*words(folder), *given, "--out", tmp_path / "whole").ok()
    part = ("--crop", "30,14,32,36", "--downscale", 2)
    sgp(*words(folder), *given, *part, "--height-mm", 6, "--out", tmp_path / "part").ok()
    positions = [read_lights(tmp_path / name / "lights.json").positions_mm
                 for name in ("whole", "part")]  # fmt: skip
    assert np.allclose(*positions)
    whole = read_normals(tmp_path / "whole").normal_map.normals
    reduced = read_normals(tmp_path / "part").normal_map
    blocks = whole[14:50, 30:62].reshape(18, 2, 16, 2, 3).mean(axis=(1, 3))
    assert angle_deg(reduced.normals, blocks)[reduced.mask].mean() < 0.6


@pytest.mark.slow
def test_a_run_has_the_height_of_the_object(sgp, folder, tmp_path):
    out = tmp_path / "run"
    sgp(
        "run", folder, "--pixel-mm", PIXEL_MM, "--light-distance-mm", DISTANCE, "--out", out
    ).ok()  # fmt: skip
    height = read_image(out / "surface" / "height.exr")[KNOWN]
    assert np.ptp(height) == pytest.approx(np.ptp(HEIGHT[KNOWN]), rel=0.1)


@cases(
    ("options", "code", "text"),
    {
        "no scale": ((), 4, "no scale: give a camera with a working distance, or the size"),
        "distant": (("--pixel-mm", 2.5, "--distant"), 4, "not for distant lights: leave it out"),
        "positions": (
            ("--pixel-mm", 2.5, "--lights", "../near.json"), 4, "not for lights with positions"
        ),
        "two estimates": (
            ("--pixel-mm", 2.5, "--light-distance-mm", "estimate", "--semi-calibrated"), 4,
            "their distance cannot both be estimated: estimate one of them",
        ),
        "a word": (("--light-distance-mm", "far"), 2, "far is not a number"),
    },
)  # fmt: skip
def test_what_a_distance_does_not_fit_is_one_line(
    sgp, folder, tmp_path, monkeypatch, options, code, text
):
    monkeypatch.chdir(folder)
    if "--light-distance-mm" not in options:
        options = ("--light-distance-mm", 400, *options)
    answer = sgp("normals", folder, *options, "--out", tmp_path / "out")
    assert text in answer.error_line(code)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_an_estimated_distance_is_within_its_deviation(sgp, folder, tmp_path):
    out = tmp_path / "out"
    given = ("--light-distance-mm", "estimate", "--out", out, "--json")
    metrics = sgp(*words(folder), *given).figures()
    sigma = metrics["light_distance_sigma_mm"]
    assert sigma < 0.05 * DISTANCE
    assert metrics["light_distance_mm"] == pytest.approx(DISTANCE, abs=2 * sigma)
    found = read_normals(out).normal_map.normals
    assert angle_deg(found, NORMALS)[KNOWN].mean() < 0.8
    errors = read_lights(out / "lights.json").errors
    assert np.allclose(np.trace(errors.covariances, axis1=1, axis2=2), sigma**2)


def test_an_object_that_shows_no_distance_is_one_line(sgp, folder, tmp_path):
    given = ("--light-distance-mm", "estimate", "--crop", "30,24,7,7")
    line = sgp(*words(folder), *given, "--out", tmp_path / "out").error_line(5)
    assert "only 49 blocks of the object are lit by 5 lights: at least 60 are required" in line
    assert not (tmp_path / "out").exists()
