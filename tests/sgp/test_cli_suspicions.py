"""Valid files with suspicious contents: the commands report them."""

from dataclasses import replace

import numpy as np
import pytest

from acquisition import (
    Lights,
    angle_deg,
    read_image,
    read_lights,
    write_exr,
    write_lights,
    write_png,
)
from processing import read_normals


@pytest.fixture
def words(recording):
    return ("normals", recording, "--lights", recording.parent / "lights.json")


def test_a_black_image_is_left_out_and_named(sgp, words, recording, tmp_path):
    assert sgp(*words, "--method", "ls", "--out", tmp_path / "whole").code == 0
    write_png(recording / "ball.3.png", np.zeros((40, 48), np.uint16))
    report = sgp(*words, "--method", "ls", "--out", tmp_path / "dead", "--json").report()
    assert any("ball.3" in line and "show no light" in line for line in report["warnings"])
    assert report["metrics"]["images"] == 7
    whole = read_normals(tmp_path / "whole").normal_map
    dead = read_normals(tmp_path / "dead").normal_map
    both = whole.mask & dead.mask
    assert angle_deg(whole.normals[both], dead.normals[both]).mean() < 6


def test_an_image_that_a_wrong_strength_makes_far_too_bright_is_left_out_and_named(
    sgp, words, tmp_path
):
    """Before, 2 % of the pixels had normals, and the others were named as in shadow."""
    lights = read_lights(words[-1])
    strengths = np.where(np.array(lights.ids) == lights.ids[3], 1e-6, 1.0)
    write_lights(words[-1], replace(lights, intensities=strengths))
    report = sgp(*words, "--method", "ls", "--out", tmp_path / "n", "--json").report()
    assert any("50 times as bright" in one and "ball.3" in one for one in report["warnings"])
    assert report["metrics"]["images"] == 7


def test_a_negative_image_is_left_out_and_named(sgp, words, recording, tmp_path):
    """Noise below the dark level is no reason to leave an image out, an offset is."""
    for i in range(8):
        image = read_image(recording / f"ball.{i}.png").astype(np.float32) / 65535
        image += np.random.default_rng(i).normal(0, 0.002, image.shape).astype(np.float32)
        (recording / f"ball.{i}.png").unlink()
        write_exr(recording / f"ball.{i}.exr", image if i != 3 else image * 0 - np.float32(0.1))
    report = sgp(*words, "--method", "ls", "--out", tmp_path / "out", "--json").report()
    (line,) = [text for text in report["warnings"] if "left out" in text]
    assert "samples are negative" in line
    assert line.endswith(": ball.3")
    assert report["metrics"]["images"] == 7


def test_lights_behind_the_object_are_refused(sgp, words, recording, tmp_path):
    path = recording.parent / "lights.json"
    turned = np.asarray(read_lights(path).directions) * [1, 1, -1]
    write_lights(path, Lights(directions=turned))
    assert "face away" in sgp(*words, "--out", tmp_path / "out").error_line(5)
    assert not (tmp_path / "out").exists()


def test_a_sphere_mask_that_is_not_a_disc_is_refused(sgp, recording, tmp_path):
    square = np.zeros((40, 48), np.uint8)
    square[10:14, 5:40] = 255
    write_png(tmp_path / "mask.png", square)
    words = ("calibrate", "spheres", recording, "--mask", tmp_path / "mask.png")
    answer = sgp(*words, "--out", tmp_path / "found.json")
    assert "not the disc of a sphere" in answer.error_line(5)
    assert not (tmp_path / "found.json").exists()


def test_unused_files_are_reported(sgp, words, recording, tmp_path):
    (recording / "notes.txt").write_text("n", encoding="utf-8")
    answer = sgp(*words, "--out", tmp_path / "out").ok()
    assert "not used: notes.txt" in answer.err
    assert "the images have no mask" in answer.err


@pytest.mark.parametrize("number", ["1.5", "2e0", "two"])
def test_a_fraction_is_not_rounded_to_a_whole_number(sgp, number):
    assert number in sgp("capture", "plan", "--led-count", number).error_line(2)


def test_an_exposure_the_camera_lacks_costs_no_folder(sgp, tmp_path):
    plan = tmp_path / "plan.toml"
    plan.write_text("leds = [0]\nexposures_us = [1]\n", encoding="utf-8")
    rig = tmp_path / "rig.toml"
    rig.write_text(
        'name = "s"\ndriver = "simulated"\nleds = 2\n[options]\nwidth = 32\nheight = 32\n',
        encoding="utf-8",
    )
    answer = sgp("capture", "run", tmp_path / "s", "--plan", plan, "--rig", rig)
    assert (answer.code, "10 to 1e+07 us" in answer.err) == (3, True)
    assert not (tmp_path / "s").exists()
