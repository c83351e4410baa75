"""`--exclude auto` and `--semi-calibrated` on the command line."""

import json

import numpy as np
import pytest

from acquisition import Lights, read_lights, write_lights, write_png

COUNT = 12
Y, X = np.mgrid[1:-1:60j, -1:1:60j]
MASK = X**2 + Y**2 < 0.9


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return images of a ball, of which number 4 is 1.3 times as bright, and their lights."""
    place = tmp_path_factory.mktemp("ball")
    turn = np.arange(COUNT) * 2.4
    z = np.linspace(0.95, 0.5, COUNT)
    r = np.sqrt(1 - z * z)
    lights = Lights(
        directions=np.stack([r * np.cos(turn), r * np.sin(turn), z], 1),
        ids=tuple(f"ball.{i}" for i in range(COUNT)),
    )
    write_lights(place / "lights.json", lights)
    images = place / "images"
    images.mkdir()
    normals = np.dstack([X, Y, np.sqrt(np.clip(1 - X**2 - Y**2, 0, 1))])
    rng = np.random.default_rng(8)
    for i, direction in enumerate(lights.unit_directions):
        image = 0.6 * np.clip(normals @ direction, 0, None) * (1.3 if i == 4 else 1)
        image = np.where(MASK, image * rng.normal(1, 0.003, image.shape), 0)
        write_png(images / f"ball.{i}.png", (65535 * image).astype(np.uint16))
    write_png(images / "mask.png", (255 * MASK).astype(np.uint8))
    return place


@pytest.fixture
def words(folder):
    return ("normals", folder / "images", "--lights", folder / "lights.json", "--method", "ls")


def test_the_image_on_another_scale_is_divided_and_recorded(sgp, words, tmp_path):
    answer = sgp(*words, "--exclude", "auto", "--out", tmp_path / "out").ok()
    assert "divided by a factor: ball.4 (1.30 times)" in " ".join(answer.err.split())
    record = json.loads((tmp_path / "out" / "normals.json").read_text(encoding="utf-8"))
    assert "excluded" not in record["metrics"]
    assert record["metrics"]["rescaled"] == {"ball.4": pytest.approx(1.3, rel=0.005)}
    assert record["metrics"]["images"] == COUNT
    assert [notice["code"] for notice in record["notices"]] == ["images-rescaled"]
    assert record["parameters"]["exclude"] == ["auto"]


def test_named_images_are_left_out_before_others_are_divided(sgp, words, tmp_path):
    metrics = sgp(*words, "--exclude", "auto,ball.0", "--out", tmp_path / "out", "--json").figures()
    assert list(metrics["rescaled"]) == ["ball.4"]
    assert metrics["images"] == COUNT - 1


def test_estimated_strengths_are_written_and_can_be_used_again(sgp, words, folder, tmp_path):
    report = sgp(*words, "--semi-calibrated", "--out", tmp_path / "out", "--json").report()
    assert report["warnings"] == []
    found = read_lights(tmp_path / "out" / "lights.json")
    others = np.delete(found.intensities[:, 0], 4).mean()
    assert found.intensities[4, 0] / others == pytest.approx(1.3, rel=0.01)
    made_by = json.loads((tmp_path / "out" / "lights.json").read_text(encoding="utf-8"))
    assert made_by["provenance"]["command"] == "sgp normals"
    hashed = [file.rsplit("/", 1)[1] for file in made_by["provenance"]["inputs"]]
    assert {"ball.4.png", "lights.json", "mask.png"} <= set(hashed)
    assert 0 < report["metrics"]["strength_sigma"] < 0.01
    again = sgp(
        "normals", folder / "images", "--lights", tmp_path / "out" / "lights.json",
        "--out", tmp_path / "again", "--json",
    )  # fmt: skip
    assert json.loads(again.out)["warnings"] == []
    assert json.loads(again.out)["metrics"]["residual_relative"] < 0.01


def test_strengths_that_are_not_determined_end_with_one_line(sgp, words, tmp_path):
    answer = sgp(*words, "--semi-calibrated", "--exclude", "3-11", "--out", tmp_path / "out")
    assert answer.code == 5
    assert "3 lights: with fewer than 4" in " ".join(answer.err.split())
    assert not (tmp_path / "out").exists()


def test_distant_strengths_are_written_with_the_positions(sgp, folder, tmp_path):
    given = read_lights(folder / "lights.json")
    near = Lights(positions_mm=9000 * given.unit_directions, mu=np.ones(COUNT), ids=given.ids)
    write_lights(tmp_path / "near.json", near)
    sgp(
        "normals", folder / "images", "--lights", tmp_path / "near.json", "--method", "ls",
        "--distant", "--semi-calibrated", "--out", tmp_path / "out",
    ).ok()  # fmt: skip
    found = read_lights(tmp_path / "out" / "lights.json")
    np.testing.assert_allclose(found.positions_mm, near.positions_mm)
    others = np.delete(found.intensities[:, 0], 4).mean()
    assert found.intensities[4, 0] / others == pytest.approx(1.3, rel=0.01)
