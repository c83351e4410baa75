"""Chrome recordings with images that do not count: left out by the user, or by the calibration."""

import json

import numpy as np
import pytest

from acquisition import angle_deg, read_image, read_lights, write_png
from tests.calibration.spheres_and_object import directions, write_recording
from tests.quick_sample import quick

EVERY = tuple(f"L{k:02d}" for k in range(8))


@pytest.fixture
def recording(tmp_path):
    folder = tmp_path / "recording"
    folder.mkdir()
    write_recording(folder)
    return folder


def change(recording, name, edit):
    path = recording / f"{name}.png"
    write_png(path, np.ascontiguousarray(edit(read_image(path))))


def bumped(image):
    return np.roll(image, (6, 4), (0, 1))


def black(image):
    return np.zeros_like(image)


def white(image):
    return np.full_like(image, 65535)


@pytest.mark.parametrize(
    ("exclude", "gone"),
    [
        pytest.param("7", "7", id="number", marks=pytest.mark.slow),
        pytest.param("L02,5-6", "256", id="name and range"),
        pytest.param("auto,L00.png", "0", id="auto and file", marks=pytest.mark.slow),
    ],
)
def test_excluded_images_have_no_lights(sgp, recording, tmp_path, exclude, gone):
    out = tmp_path / "l.json"
    sgp("calibrate", "spheres", recording, "--exclude", exclude, "--out", out).ok()
    kept = [k for k in range(8) if str(k) not in gone]
    for path in (out, out.with_suffix(".lp")):
        lights = read_lights(path)
        assert len(lights) == len(kept)
        assert angle_deg(lights.unit_directions, directions()[kept]).max() < 0.4
    assert read_lights(out).ids == tuple(EVERY[k] for k in kept)
    made_by = json.loads(out.read_text())["provenance"]["parameters"]
    assert made_by["exclude"] == exclude.split(",")


@pytest.mark.parametrize(
    ("exclude", "code", "says"),
    [
        ("L99", 4, "no image is named 'L99': there are L00, L01"),
        ("0-7", 4, "no image is left: all 8 images are excluded"),
        ("1,,2", 2, "--exclude: a name is empty"),
    ],
)
def test_wrong_names_are_refused(sgp, recording, tmp_path, exclude, code, says):
    words = ("calibrate", "spheres", recording, "--exclude", exclude)
    assert says in sgp(*words, "--out", tmp_path / "l.json").error_line(code)


@pytest.mark.slow
def test_images_are_left_out_of_all_recordings(sgp, recording, tmp_path):
    words = ("calibrate", "spheres", recording, recording.parent / "other", "--exclude", "L03")
    (tmp_path / "other").mkdir()
    write_recording(tmp_path / "other")
    sgp(*words, "--out", tmp_path / "l.json").ok()
    assert read_lights(tmp_path / "l.json").ids == EVERY[:3] + EVERY[4:]


LOST = {
    "bumped": (bumped, "image-displaced", "light L03: the spheres at (50, 60), (255, 140) px are"),
    "black": (black, "image-blank", "light L03: the image is black; the light is left out"),
    "white": (white, "image-blank", "light L03: the image is completely saturated; the light is"),
}


@pytest.mark.parametrize(("edit", "code", "says"), quick(LOST.values(), every=3), ids=LOST.keys())
def test_an_image_that_does_not_count_costs_its_light_only(
    sgp, recording, tmp_path, edit, code, says
):
    change(recording, "L03", edit)
    out = tmp_path / "l.json"
    answer = sgp("calibrate", "spheres", recording, "--out", out, "--json").ok()
    texts = {one["code"]: one["text"] for one in json.loads(answer.out)["notices"]}
    assert texts[code].startswith(says)
    own = tmp_path / "own.json"
    assert sgp("calibrate", "spheres", recording, "--exclude", "3", "--out", own).code == 0
    assert read_lights(out).ids == read_lights(own).ids == EVERY[:3] + EVERY[4:]
    np.testing.assert_array_equal(read_lights(out).directions, read_lights(own).directions)
    # The image of the object under this light is not used, either.
    words = ("inspect", recording, "--lights", out)
    assert "7 images, distant lights" in sgp(*words).out


@pytest.mark.slow
@pytest.mark.parametrize("command", quick(["calibrate", "run"], every=2))
def test_the_refusal_says_what_to_exclude_and_that_helps(sgp, recording, tmp_path, command):
    for name in ("L03", "L06"):
        change(recording, name, bumped)
    words, out = ("calibrate", "spheres", recording), tmp_path / "l.json"
    if command == "run":
        words, out = ("run", recording, "--spheres", "--align", "off"), tmp_path / "result"
    answer = sgp(*words, "--out", out)
    line = answer.error_line(5)
    assert "to calibrate the other lights, add --exclude L03,L06" in line
    assert "--sphere" not in line.replace("spheres", "")
    sgp(*words, "--exclude", "L03,L06", "--out", out).ok()
    lights = read_lights(out if command == "calibrate" else out / "lights.json")
    kept = [0, 1, 2, 4, 5, 7]
    assert lights.ids == tuple(EVERY[k] for k in kept)
    assert angle_deg(lights.unit_directions, directions()[kept]).max() < 0.4


@pytest.mark.slow
def test_the_hint_names_no_sphere_that_was_found(sgp, recording, tmp_path):
    """A mark of the same sphere would give the same error."""
    for k in (1, 4, 6):
        change(recording, EVERY[k], lambda image: np.where(image > 9000, 6553, image))
    answer = sgp("calibrate", "spheres", recording, "--out", tmp_path / "l.json")
    line = answer.error_line(5)
    assert "no highlight under light L01, L04, L06 (3 of 8 lights)" in line
    assert "add --exclude L01,L04,L06" in line
    assert "add --sphere" not in line
    assert not (tmp_path / "l-candidates.png").exists()


def test_no_mark_is_proposed_if_images_are_blank(sgp, recording, tmp_path):
    """The spheres were not searched for."""
    for name in ("L03", "L06"):
        change(recording, name, black)
    answer = sgp("calibrate", "spheres", recording, "--out", tmp_path / "l.json")
    assert answer.error_line(5).endswith("to calibrate the other lights, add --exclude L03,L06")
    assert not (tmp_path / "l-candidates.png").exists()


@pytest.mark.slow
def test_refusals_of_several_recordings_say_what_to_exclude(sgp, recording, tmp_path):
    (tmp_path / "other").mkdir()
    write_recording(tmp_path / "other")
    for name in ("L03", "L06"):
        change(recording, name, bumped)
    words = ("calibrate", "spheres", recording, tmp_path / "other", "--out", tmp_path / "l.json")
    assert sgp(*words).error_line(5).endswith("add --exclude L03,L06")
    assert sgp(*words, "--exclude", "L03,L06").code == 0
