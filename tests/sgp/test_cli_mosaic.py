"""The command line on the frames of a colour mosaic: a coin with a red and blue checkerboard."""

import json

import pytest

from acquisition import read_image

SCENE = """
[object]
kind = "coin"
radius_mm = 60
[pattern]
kind = "checker"
square_mm = 12
low = [0.7, 0.2, 0.15]
high = [0.2, 0.35, 0.8]
[board]
kind = "even"
albedo = 0.05
[lights]
kind = "dome"
[lens]
kind = "perspective"
width = 480
height = 400
cfa = "RGGB"
"""


@pytest.fixture
def coin(sgp, tmp_path):
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / "coin.toml").write_text(SCENE, encoding="utf-8")
    sgp("simulate", folder / "coin.toml", "--out", folder / "session").ok()
    return folder / "session"


@pytest.mark.slow
def test_sites_of_a_mosaic_give_better_normals_at_edges_of_colours(sgp, coin, tmp_path):
    errors = {}
    for channel in ("gray", "mosaic"):
        out = tmp_path / channel
        lights = coin / "derived" / "truth" / "lights.json"
        errors[channel] = sgp(
            "normals", coin, "--lights", lights, "--channel", channel, "--out", out, "--json"
        ).figures()["mae_deg"]
        record = json.loads((out / "normals.json").read_text(encoding="utf-8"))
        assert record["parameters"]["channel"] == channel
        assert read_image(out / "albedo.exr").shape == (400, 480, 3)
    assert errors["mosaic"] < 0.6 * errors["gray"]
    assert errors["mosaic"] < 0.6


def test_images_without_a_mosaic_get_one_line(sgp, tmp_path):
    session = tmp_path / "coin"
    sgp("simulate", "coin", "--out", session, "--size", "64x48", "--led-count", "4")
    lights = session / "derived" / "truth" / "lights.json"
    line = sgp(
        "normals", session, "--lights", lights, "--channel", "mosaic", "--out", tmp_path / "n"
    ).error_line(4)
    assert "L00_E0.tif: the image has no colour mosaic: use gray" in line
    assert not (tmp_path / "n").exists()
