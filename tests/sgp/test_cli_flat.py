"""``sgp calibrate flat`` and ``--flat``, on simulated sessions of a card and of a plaque."""

import json
import shutil

import numpy as np
import pytest

from acquisition import read_image
from acquisition.value_files import read_flat

SCENE = """
[board]
kind = "even"
albedo = 0.9
[lights]
kind = "dome"
count = 8
[lens]
kind = "perspective"
width = 96
height = 80
field_mm = 290
working_distance_mm = 400
vignetting = 0.93
[sensor]
prnu = 0.01
"""
OBJECT = """
[object]
kind = "plane"
radius_mm = 200
[pattern]
kind = "even"
albedo = 0.5
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Two recordings of a card, one of a gray plane, and the flat of the first."""
    from sgp.app import build, run

    root = tmp_path_factory.mktemp("flat")
    (root / "card.toml").write_text(SCENE, encoding="utf-8")
    (root / "gray.toml").write_text(OBJECT + SCENE.replace("0.9\n", "0.02\n"), encoding="utf-8")
    (root / "small.toml").write_text(SCENE.replace("96", "80"), encoding="utf-8")
    (root / "lens.toml").write_text(SCENE.replace("290", "280"), encoding="utf-8")
    for line in (
        f"simulate {root}/card.toml --out {root}/card",
        f"simulate {root}/card.toml --out {root}/turned --seed 1",
        f"simulate {root}/gray.toml --out {root}/gray",
        f"simulate {root}/small.toml --out {root}/small",
        f"simulate {root}/lens.toml --out {root}/lens",
        f"calibrate flat {root}/card --lights {lights(root)} --out {root}/flat",
    ):
        assert run(build(), line.split()) == 0
    return root


def lights(root):
    return root / "card" / "derived" / "truth" / "lights.json"


def test_the_command_writes_a_flat_with_its_record(sgp, place, tmp_path):
    out = tmp_path / "flat"
    words = ("calibrate", "flat", place / "card", place / "turned", "--lights", lights(place))
    figures = sgp(*words, "--out", out, "--json").figures()
    assert np.mean(figures["corners"]) == pytest.approx(0.7, abs=0.02)
    assert figures["prnu"] == pytest.approx(0.01, rel=0.1)
    assert figures["frames"] == 16
    assert figures["card_std"] < 0.003
    assert sorted(path.name for path in out.iterdir()) == [
        "flat.json", "flat.png", "pixel.exr", "smooth.exr",
    ]  # fmt: skip
    record = json.loads((out / "flat.json").read_text())
    made_by = record["provenance"]
    assert made_by["command"] == "sgp calibrate flat"
    assert len(made_by["parameters"]["source"]) == 2
    assert any(name.endswith("lights.json") for name in made_by["inputs"])
    assert read_flat(out).calibrated.setup.camera_model == "virtual camera"
    again = sgp("calibrate", "flat", place / "card", "--lights", lights(place), "--out", out)
    assert "already contains files" in again.error_line(2)


@pytest.mark.slow
def test_the_albedo_of_an_even_object_becomes_even(sgp, place, tmp_path):
    spread = []
    for flat in ([], ["--flat", place / "flat"]):
        out = tmp_path / f"n{len(flat)}"
        sgp("normals", place / "gray", "--lights", lights(place), *flat, "--out", out).ok()
        albedo = read_image(out / "albedo.exr")[read_image(out / "mask.png") > 0]
        spread.append(albedo.std() / albedo.mean())
    assert spread[0] > 0.05
    assert spread[1] < 0.015
    record = json.loads((out / "normals.json").read_text())
    assert record["parameters"]["flat"] == str(place / "flat")
    assert {name.rpartition("/")[2] for name in record["inputs"] if "/flat/" in name} == {
        "flat.json", "smooth.exr", "pixel.exr",
    }  # fmt: skip


@pytest.mark.parametrize("source", ["small", "lens"])
def test_a_flat_of_another_camera_gets_one_line(sgp, place, tmp_path, source):
    flat = ("--flat", place / "flat" / "flat.json")
    given = ("--lights", lights(place), *flat)
    for words in (
        ("normals", place / source, *given, "--out", tmp_path / "n"),
        ("run", place / source, *given, "--out", tmp_path / "r"),
        ("inspect", place / source, *given),
        ("calibrate", "intensities", place / source, *given, "--out", tmp_path / "l.json"),
        ("calibrate", "spheres", place / source, *flat, "--out", tmp_path / "s.json"),
    ):
        line = sgp(*words).error_line(4)
        what = "80 x 80 pixels" if source == "small" else "another camera or lens: focal length"
        assert what in line
        assert str(place / source) in line
        assert f"the flat is {place / 'flat' / 'flat.json'}" in line


def test_the_flat_of_a_card_takes_its_vignetting_away(sgp, place, tmp_path):
    corners = []
    for flat in ([], ["--flat", place / "flat"]):
        answer = sgp(
            "calibrate", "intensities", place / "turned", "--lights", lights(place), "--even",
            *flat, "--out", tmp_path / f"{len(flat)}.json", "--json",
        ).ok()  # fmt: skip
        corners.append(json.loads(answer.out)["metrics"]["vignetting_corner"])
    assert corners[0] == pytest.approx(0.7, abs=0.01)
    assert corners[1] == pytest.approx(1, abs=0.01)


def test_bad_input_gets_one_line(sgp, place, tmp_path):
    """What, where and what to do; no folder is left."""
    out = tmp_path / "out"
    broken = shutil.copytree(place / "flat", tmp_path / "broken")
    (broken / "pixel.exr").write_bytes(b"")
    card = ("calibrate", "flat", place / "card")
    cases = [
        ((*card, "--lights", tmp_path / "none.json"), 2, "none.json"),
        ((*card, place / "small", "--lights", lights(place)), 4, "of one size"),
        ((*card, "--lights", lights(place), "--height-mm", "500"), 4, "not in front of the camera"),
        (
            ("normals", place / "card", "--lights", lights(place), "--flat", broken),
            4,
            "pixel.exr",
        ),
        (
            ("normals", place / "card", "--lights", lights(place), "--flat", place / "card"),
            2,
            "flat.json: no such file",
        ),
    ]
    for words, code, text in cases:
        assert text in sgp(*words, "--out", out).error_line(code), words
        assert not out.exists()
