"""Bad input gets one clear line and the right exit code, and no existing file changes."""

import json

import numpy as np
import pytest

from acquisition import write_exr, write_png
from acquisition.pixels import write_tiff

FULL = 65535


def spoil_lights(recording, change):
    path = recording.parent / "lights.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    change(content["lights"])
    # Python writes NaN as a bare word, as a careless program might.
    path.write_text(json.dumps(content), encoding="utf-8")


def zero(lights):
    lights[3]["direction"] = [0, 0, 0]


def not_a_number(lights):
    lights[3]["direction"][1] = float("nan")


def text(lights):
    lights[3]["direction"][1] = "north"


def shrink_bits(recording):
    write_png(recording / "ball.5.png", np.full((40, 48), 90, np.uint8))


def saturate_the_object(recording):
    for i in range(8):
        image = np.zeros((40, 48), np.uint16)
        image[10:30, 10:30] = FULL
        write_png(recording / f"ball.{i}.png", image)


def light_twice(recording):
    """Every pixel of the object is lit by two lights only."""
    for i in range(8):
        image = np.zeros((40, 48), np.uint16)
        image[10:30, 4 + 10 * (i // 2) : 14 + 10 * (i // 2)] = 9000 + 5000 * (i % 2)
        write_png(recording / f"ball.{i}.png", image)
    mask = np.zeros((40, 48), np.uint8)
    mask[10:30, 4:44] = 255
    write_png(recording / "mask.png", mask)


def near(lights):
    for light in lights:
        light["position_mm"] = [400 * x for x in light.pop("direction")]


def zero_intensity(lights):
    lights[3]["intensity"] = [0, 0, 0]


def frames_of(value, count):
    """Return a change that writes images of floats, of which the last ones have a value."""

    def change(recording):
        for i in range(8):
            (recording / f"ball.{i}.png").unlink()
            image = np.zeros((40, 48), np.float32)
            image[10:30, 10:30] = value if i >= 8 - count else 0.4
            write_exr(recording / f"ball.{i}.exr", image)

    return change


def drop_image(recording):
    (recording / "ball.7.png").unlink()


def resize_image(recording):
    write_png(recording / "ball.5.png", np.zeros((40, 47), np.uint16))


def truncate_png(recording):
    path = recording / "ball.5.png"
    path.write_bytes(path.read_bytes()[:-200])


def truncate_tiff(recording):
    for i in range(8):
        (recording / f"ball.{i}.png").unlink()
        write_tiff(recording / f"ball.{i}.tif", np.full((40, 48), 900, np.uint16))
    path = recording / "ball.5.tif"
    path.write_bytes(path.read_bytes()[:2000])


def fill(value):
    def change(recording):
        for i in range(8):
            write_png(recording / f"ball.{i}.png", np.full((40, 48), value, np.uint16))

    return change


def mask_of(value, size=(40, 48)):
    def change(recording):
        write_png(recording / "mask.png", np.full(size, value, np.uint8))

    return change


def lights_of(change):
    return lambda recording: spoil_lights(recording, change)


def keep_lights(count):
    def change(recording):
        spoil_lights(recording, lambda lights: lights.__delitem__(slice(count, None)))
        for i in range(count, 8):
            (recording / f"ball.{i}.png").unlink()

    return change


def coplanar(lights):
    for i, light in enumerate(lights):
        light["direction"] = [i - 3.5, 0.0, 4.0]


def empty(recording):
    for path in recording.iterdir():
        path.unlink()


@pytest.mark.parametrize(
    ("spoil", "code", "words"),
    [
        pytest.param(empty, 4, ["ball", "empty"], id="empty folder"),
        pytest.param(drop_image, 4, ["7 images", "8 lights"], id="7 images for 8 lights"),
        pytest.param(lights_of(zero), 4, ["lights.json", "L03"], id="zero light"),
        pytest.param(lights_of(not_a_number), 4, ["lights.json"], id="NaN light"),
        pytest.param(lights_of(text), 4, ["lights.json"], id="light of words"),
        pytest.param(lights_of(zero_intensity), 4, ["lights.json", "L03"], id="zero intensity"),
        pytest.param(frames_of(np.nan, 1), 4, ["ball.7.exr", "NaN"], id="NaN frame"),
        pytest.param(frames_of(-0.1, 8), 5, ["black"], id="negative frames"),
        pytest.param(resize_image, 4, ["ball.5.png", "47"], id="another size"),
        pytest.param(fill(0), 5, ["black"], id="all black"),
        pytest.param(fill(FULL), 5, ["saturated"], id="all saturated"),
        pytest.param(saturate_the_object, 5, ["black or saturated"], id="object saturated"),
        pytest.param(light_twice, 5, ["lit by 3 lights", "in shadow"], id="two lights each"),
        pytest.param(shrink_bits, 4, ["ball.5.png", "uint8", "uint16"], id="mixed bit depth"),
        pytest.param(lights_of(near), 4, ["working distance"], id="near without a camera"),
        pytest.param(mask_of(0), 4, ["mask.png", "inside"], id="mask of zeros"),
        pytest.param(mask_of(255, (40, 40)), 4, ["mask.png", "40 x 40"], id="mask size"),
        pytest.param(keep_lights(2), 5, ["2 lights", "at least 3"], id="two lights"),
        pytest.param(lights_of(coplanar), 5, ["one plane"], id="coplanar lights"),
        pytest.param(truncate_png, 4, ["ball.5.png"], id="truncated PNG"),
        pytest.param(truncate_tiff, 4, ["ball.5.tif"], id="truncated TIFF"),
    ],
)
def test_normals_refuses(sgp, recording, spoil, code, words):
    spoil(recording)
    before = sorted(path.name for path in recording.iterdir())
    out = recording.parent / "out"
    answer = sgp("normals", recording, "--lights", recording.parent / "lights.json", "--out", out)
    line = answer.error_line(code)
    for word in words:
        assert word in line
    assert not out.exists()
    assert sorted(path.name for path in recording.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        pytest.param(["normals", "nowhere", "--out", "o"], "nowhere", id="missing source"),
        pytest.param(["surface", "nowhere", "--out", "o"], "nowhere", id="missing normals"),
        pytest.param(["compare", "nowhere", "nothing"], "nowhere", id="missing map"),
        pytest.param(["capture", "verify", "nowhere"], "nowhere", id="missing session"),
        pytest.param(["capture", "info", "nowhere"], "nowhere", id="missing session info"),
        pytest.param(["calibrate", "spheres", "no", "--out", "l.json"], "no", id="no spheres"),
        pytest.param(["normals", ".", "--out", "o", "--method", "bets"], "bets", id="method"),
        pytest.param(["rig", "check", "--rig", "unicorn"], "unicorn", id="unknown rig"),
        pytest.param(
            ["calibrate", "spheres", ".", "--mask", "m", "--sphere", "9,9,5", "--out", "l.json"],
            "give only one",
            id="spheres marked twice",
        ),
    ],
)
def test_usage(sgp, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    assert message in sgp(*words).error_line(2)
    assert list(tmp_path.iterdir()) == []


def test_results_are_not_overwritten_without_force(sgp, recording):
    out = recording.parent / "out"
    command = ("normals", recording, "--lights", recording.parent / "lights.json", "--out", out)
    assert sgp(*command).code == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert "--force" in sgp(*command, "--method", "ls").error_line(2)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert sgp(*command, "--method", "ls", "--force").code == 0


def test_matching_lights_to_images_by_order_is_reported(sgp, recording):
    answer = sgp(
        "normals", recording, "--lights", recording.parent / "lights.json",
        "--out", recording.parent / "out",
    ).ok()  # fmt: skip
    assert "by order" in answer.err


def test_a_demo_folder_replaces_nothing_but_a_demo(sgp, tmp_path):
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    assert sgp("demo", "--out", tmp_path).code == 2
    assert (tmp_path / "thesis.txt").read_text(encoding="utf-8") == "years of work"
