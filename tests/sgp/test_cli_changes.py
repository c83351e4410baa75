"""`sgp compare --register --significance`: one object before and after."""

import csv
import json
import shutil

import cv2
import numpy as np
import pytest

from acquisition import read_image, write_exr, write_png
from benchmarks.relief_fields import View, relief, seen, write_field
from processing import NormalMap, write_normals
from tests.sgp.conftest import ball

SIZE = 200, 260
SIGMA = 0.004


def surface(seed):
    noise = np.random.default_rng(seed).normal(size=SIZE)
    return 12 * cv2.GaussianBlur(noise, (0, 0), 3)


def write(folder, height, seed, *, sigma=True):
    """Write a result with the normals of heights in pixels."""
    down, right = np.gradient(height)
    noise = np.random.default_rng([seed, 9]).normal(0, SIGMA, (*SIZE, 2))
    normals = np.dstack([noise[..., 0] - right, noise[..., 1] + down, np.ones(SIZE)])
    write_normals(folder, NormalMap.from_vectors(normals))
    if sigma:
        deviations = np.full(SIZE, np.degrees(SIGMA * np.sqrt(2)), np.float32)
        write_exr(folder / "normal_sigma_deg.exr", deviations)
    return folder


@pytest.fixture
def recorded(tmp_path):
    """Results before, after without and with a loss, of another object, and without error bars."""
    still = surface(1)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    loss = 0.3 * np.exp(-0.5 * ((rows - 80) ** 2 + (columns - 150) ** 2) / 2.5**2)
    write(tmp_path / "before", still, 1)
    write(tmp_path / "same", still, 2)
    # Moved to the right by three pixels.
    write(tmp_path / "lost", np.roll(still - loss, 3, axis=1), 3)
    write(tmp_path / "other", surface(5), 4)
    write(tmp_path / "mirrored", still[:, ::-1], 6)
    write(tmp_path / "bare", still, 5, sigma=False)
    return tmp_path


def compare(sgp, folder, after, *words):
    names = folder / "before", folder / after
    return sgp("compare", *names, "--register", *words, "--out", folder / "out")


def test_a_loss_is_found_with_place_and_depth(sgp, recorded):
    compare(sgp, recorded, "lost", "--significance", "--pixel-mm", "0.05").ok()
    out = recorded / "out"
    with (out / "changes.csv").open() as file:
        (row,) = csv.DictReader(file)
    assert (float(row["column_px"]), float(row["row_px"])) == pytest.approx((150, 80), abs=2)
    assert float(row["x_mm"]) == pytest.approx(0.05 * (150 - 129.5), abs=0.1)
    assert float(row["y_mm"]) == pytest.approx(0.05 * (99.5 - 80), abs=0.1)
    height, sigma = float(row["height_mm"]), float(row["height_sigma_mm"])
    assert abs(height + 0.3 * 0.05) < 2 * sigma < 0.006
    assert read_image(out / "change_height.exr")[80, 150] == pytest.approx(-0.015, rel=0.3)
    record = json.loads((out / "compare.json").read_text())
    metrics = record["metrics"]
    assert metrics["shift_px"] == pytest.approx([3, 0], abs=0.05)
    assert metrics["changes"] == 1
    assert metrics["unit"] == "mm"
    assert set(record["outputs"].values()) == {path.name for path in out.iterdir()} - {
        "compare.json"
    }


def test_no_change_is_stated_with_what_would_have_been_found(sgp, recorded):
    answer = compare(sgp, recorded, "same", "--significance").ok()
    assert "changes       none significant" in answer.out
    assert answer.out.count("would have been found with 95 %") == 4
    assert (recorded / "out" / "changes.csv").read_text().startswith("number,kind,column_px")
    assert not read_image(recorded / "out" / "significant.png").any()


def test_without_error_bars_only_the_difference_is_shown(sgp, recorded):
    compare(sgp, recorded, "bare").ok()
    assert {path.name for path in (recorded / "out").iterdir()} == {
        "compare.json",
        "difference.png",
        "mask.png",
        "normals.exr",
        "normals.png",
        "normals_deg.exr",
    }


@pytest.mark.parametrize(
    ("after", "words", "code", "message"),
    [
        ("bare", ["--significance"], 4, "no normal_sigma_deg.exr"),
        ("other", ["--significance"], 5, "nothing in common"),
        ("mirrored", ["--significance"], 5, "mirrored"),
    ],
)
def test_fields_that_cannot_be_compared(sgp, recorded, after, words, code, message):
    answer = compare(sgp, recorded, after, *words)
    assert answer.code == code
    assert message in answer.err
    assert not (recorded / "out").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--significance"], "--significance compares registered maps"),
        (["--pixel-mm", "1"], "--pixel-mm compares registered maps"),
        (["--register", "--significance"], "give --out"),
        (["--register", "--false-alarm", "1.5"], "--false-alarm"),
    ],
)
def test_options_that_do_not_fit(sgp, recorded, words, message):
    answer = sgp("compare", recorded / "before", recorded / "same", *words)
    assert answer.code == 2
    assert message in answer.err


@pytest.fixture
def scaled(tmp_path):
    """The same relief three times: without a scale, with one, and with another one."""
    whole = relief((170, 190), 5)
    for number, (name, pixel_mm) in enumerate((("none", None), ("fine", 0.05), ("wide", 0.06))):
        field = seen(whole, View(95, 85, 0.0), (120, 140), number)[0]
        write_field(tmp_path / name, field, pixel_mm=pixel_mm)
    return tmp_path


def test_a_scale_that_is_known_of_one_only(sgp, scaled):
    words = ("compare", scaled / "fine", scaled / "none", "--register")
    line = sgp(*words).error_line(4)
    assert str(scaled / "none") in line
    assert "its scale is not known" in line
    assert sgp(*words, "--pixel-mm", "0.05", "--json").figures()["unit"] == "mm"


def test_scales_that_contradict_each_other(sgp, scaled):
    answer = sgp("compare", scaled / "fine", scaled / "wide", "--register", "--json")
    assert "scales-contradict" in answer.codes()
    alike = sgp("compare", scaled / "fine", scaled / "fine", "--register", "--json")
    assert "scales-contradict" not in alike.codes()


def test_results_of_the_same_images_are_refused(sgp, recording, tmp_path):
    """With other options, their noise is still the same; a recording after it may have its mask."""
    mask = np.full(ball()[1].shape, 255, np.uint8)
    write_png(recording / "mask.png", mask)
    shutil.move(tmp_path / "lights.json", recording)
    for number in range(7):
        write_png(recording / f"dark.{number}.png", np.full(mask.shape, 7 + number, np.uint16))
    later = shutil.copytree(recording, tmp_path / "later")
    for path in later.glob("ball.*"):
        write_png(path, read_image(path) // 2)
    runs = {
        "first": (recording, "--exclude", "ball.5,ball.6,ball.7"),
        "again": (recording, "--exclude", "ball.5,ball.6,ball.7", "--gamma", "linear"),
        "part": (recording, "--exclude", "ball.0,ball.1,ball.2"),
        "rest": (recording, "--exclude", "ball.0,ball.1,ball.2,ball.3,ball.4"),
        "later": (later,),
    }
    for name, words in runs.items():
        lit = ("--lights", words[0] / "lights.json", "--out", tmp_path / f"of {name}")
        sgp("normals", *words, "--method", "ls", *lit).ok()
    for name, same in {"again": True, "part": True, "rest": False, "later": False}.items():
        pair = tmp_path / "of first", tmp_path / f"of {name}"
        words = "--register", "--significance", "--out", tmp_path / "out"
        assert ("from the same images" in sgp("compare", *pair, *words).err) == same
        assert ("from the same images" in sgp("merge", *pair, "--out", tmp_path / name).err) == same
        assert not (same and (tmp_path / name).exists())
