"""The command that joins fields, on results of a relief that was cut into overlapping fields."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from acquisition import read_image, write_exr, write_lights, write_png
from benchmarks.relief_fields import View, relief, seen, true_normals, write_field
from tests.sgp.conftest import ring_lights
from tests.sgp.in_bands import CTRL_C, check_equal, interrupted
from tests.sgp.test_cli_batch import here  # noqa: F401

SIZE = (150, 180)
VIEWS = (View(130, 120, 0.03), View(255, 115, -0.04), View(128, 228, 1.6), View(250, 222, 3.0))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with results A to D of overlapping fields, and X of another object."""
    folder = tmp_path_factory.mktemp("fields")
    whole = relief((350, 390), 43)
    for number, view in enumerate(VIEWS):
        write_field(folder / "ABCD"[number], seen(whole, view, SIZE, number)[0], pixel_mm=0.05)
    write_field(folder / "X", seen(relief((350, 390), 78), VIEWS[0], SIZE, 9)[0])
    return folder


@pytest.fixture
def place(made: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_whole(sgp, place: Path) -> None:
    figures = sgp("merge", *"ABCD", "--out", "whole", "--json").figures()
    assert [field["field"] for field in figures["fields"]] == [*"ABCD"]
    assert figures["residual_px"] < 0.1
    assert figures["pixel_mm"] == 0.05
    assert all(pair["used"] for pair in figures["pairs"])
    turns = [field["turn_deg"] for field in figures["fields"]]
    np.testing.assert_allclose(turns, np.degrees([view.turn - 0.03 for view in VIEWS]), atol=0.1)
    assert {path.name for path in (place / "whole").iterdir()} == {
        "albedo.exr",
        "albedo.png",
        "fields.png",
        "mask.png",
        "merge.json",
        "merge.png",
        "normal_sigma_deg.exr",
        "normals.exr",
        "normals.png",
    }
    sigma = ("--sigma", "whole/normal_sigma_deg.exr")
    sgp("surface", "whole", *sigma, "--albedo", "whole/albedo.exr", "--out", "surface").ok()
    assert sgp("compare", "whole", "whole", "--json").figures()["mae_deg"] < 0.01
    sgp("verify", "whole").ok()


def test_the_pixels_of_reduced_fields_have_their_size(sgp, place: Path) -> None:
    record = place / "A" / "normals.json"
    halves = '"pixel_mm": 0.025, "downscale": 2'
    record.write_text(record.read_text().replace('"pixel_mm": 0.05', halves))
    assert sgp("merge", *"AB", "--out", "whole", "--json").figures()["pixel_mm"] == 0.05


def test_an_interrupted_merge_continues_in_bands(sgp, bands, place: Path, monkeypatch) -> None:
    """In files and in memory, the whole is the same."""
    monkeypatch.setattr("processing.merging.fusion._ROWS", 64)
    words = ("merge", *"ABC", "--out")
    sgp(*words, "one").ok()
    message = sgp(*words, "two", "--memory", "1M").error_line(2)
    least = message.partition("at least --memory ")[2].strip()
    error, code = CTRL_C
    with interrupted(error, after=2):
        assert sgp(*words, "two", "--memory", least).code == code
    assert len(bands) == 2
    sgp(*words, "two", "--memory", least).ok()
    assert [units.start for _, units in bands] == [0, 1, 2, 3, 4]
    check_equal(place / "two", place / "one")


def test_fields_without_standard_deviations(sgp, place: Path) -> None:
    record = place / "B" / "normals.json"
    content = json.loads(record.read_text())
    del content["metrics"]["normal_sigma_deg"]
    record.write_text(json.dumps(content))
    answer = sgp("merge", *"AB", "--out", "whole", "--json")
    assert answer.codes() == ["fields-without-sigma"]
    assert answer.figures()["normal_sigma_deg"] is None
    assert np.isnan(read_image(place / "whole" / "normal_sigma_deg.exr")).all()


def test_fields_that_disagree(sgp, place: Path) -> None:
    for name in "AB":
        file = place / name / "normal_sigma_deg.exr"
        write_exr(file, read_image(file) / 4)
    answer = sgp("merge", *"AB", "--out", "whole", "--json")
    assert answer.codes() == ["fields-disagree"]
    assert answer.figures()["pairs"][0]["disagreement"] == pytest.approx(4, rel=0.15)


@pytest.mark.slow
def test_recordings_are_processed_first_and_once(sgp, here, tmp_path, monkeypatch) -> None:  # noqa: F811
    monkeypatch.chdir(tmp_path)
    whole, lights = relief((180, 220), 5), ring_lights(8)
    rows, columns = np.mgrid[:180, :220].astype(float)
    shading = true_normals(whole, columns, rows) @ lights.unit_directions.T
    images = np.uint16(60000 * shading.clip(0) * (whole.albedo / whole.albedo.max())[..., None])
    for name, part in (("left", np.s_[:, :140]), ("right", np.s_[:, 80:])):
        (tmp_path / name).mkdir()
        for number in range(8):
            write_png(tmp_path / name / f"{number}.png", images[part][..., number])
        write_png(tmp_path / name / "mask.png", np.full((180, 140), 255, np.uint8))
    write_lights(tmp_path / "lights.json", lights)
    (tmp_path / "fields.toml").write_text('[run]\nlights = "lights.json"\npixel-mm = 0.1\n')
    words = ("merge", "left", "right", "--recipe", "fields.toml", "--out", "whole", "--force")
    first, second = sgp(*words, "--json").figures()["fields"]
    assert second["column_px"] - first["column_px"] == pytest.approx(80, abs=0.05)
    answer = sgp(*words)
    answer.ok()
    assert "2 results are up to date" in answer.err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("A X", 5, "A and X have nothing in common"),
        ("A B C X", 5, "X shows nothing of what the other fields show"),
        ("A", 4, "give at least two fields"),
        ("A B A", 2, "A is given twice"),
        ("A B --recipe fields.toml", 2, "fields.toml: all fields are results already"),
        ("A B nowhere", 2, "nowhere: no such file or folder"),
        ("A B unscaled", 4, "pixels of 0.05 mm and unscaled of 0.1 mm"),
        ("A B cut", 2, "cut: has no normals.exr"),
        ("A B --max-pixels 40000", 4, "the whole has"),
    ],
)
def test_bad_input(sgp, place: Path, words: str, code: int, message: str) -> None:
    (place / "fields.toml").touch()
    shutil.copytree(place / "C", place / "cut")
    (place / "cut" / "normals.exr").unlink()
    shutil.copytree(place / "C", place / "unscaled")
    record = place / "unscaled" / "normals.json"
    record.write_text(record.read_text().replace('"pixel_mm": 0.05', '"pixel_mm": 0.1'))
    assert message in sgp("merge", *words.split(), "--out", "out").error_line(code)
    assert not (place / "out").exists()


@pytest.mark.usefixtures("here")
def test_a_recording_that_fails_ends_the_merge(sgp, place: Path) -> None:
    (place / "empty").mkdir()
    answer = sgp("merge", *"AB", "empty", "--out", "out")
    assert answer.code == 4
    last = answer.err.splitlines()[-1]
    assert "empty cannot be processed: " in last
    assert "the folder is empty" in last
    assert not (place / "out").exists()
