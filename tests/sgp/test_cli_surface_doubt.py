"""`sgp surface` with deviations, known heights and bad input: files, figures and messages."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import (
    LightErrors,
    read_image,
    write_camera,
    write_exr,
    write_lights,
    write_mask,
    write_png,
)
from processing import NormalMap, write_normals
from simulator import bench_camera
from tests.quick_sample import quick
from tests.sgp.conftest import ball, ring_lights

ROWS, COLUMNS = 40, 52


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a noisy dome, its deviations, and known heights in several forms."""
    monkeypatch.chdir(tmp_path)
    y, x = np.mgrid[1 : -1 : ROWS * 1j, -1 : 1 : COLUMNS * 1j]
    rng = np.random.default_rng(1)
    vectors = np.dstack([0.3 * x, 0.3 * y, 0 * x + 1]) + 0.01 * rng.normal(size=(ROWS, COLUMNS, 3))
    mask = np.hypot(x, y) < 0.95
    write_normals("n", NormalMap.from_vectors(vectors, mask))
    write_exr("sigma.exr", np.where(mask, 0.8, np.nan).astype(np.float32))
    Path("points.csv").write_text("x_px,y_px,height_mm\n26,20,7.5\n26,30,7\n0,0,1\n90,2,1\n")
    return tmp_path


def test_deviations_and_known_heights(sgp, folder: Path) -> None:
    answer = sgp(
        *("surface", "n", "--sigma", "sigma.exr", "--height-sigma", "--pixel-mm", "0.5"),
        *("--prior", "points.csv", "--prior-sigma", "0.01", "--out", "s"),
    )
    assert answer.code == 0, answer.err
    assert "2 heights of the prior, of 4, are outside the mask and not used" in answer.err
    assert "standard deviation of heights" in answer.out + answer.err
    assert "of differences over 1, 10 px" in answer.out + answer.err
    stored = json.loads(Path("s/surface.json").read_text(encoding="utf-8"))
    assert {Path(name).name for name in stored["inputs"]} >= {"sigma.exr", "points.csv"}
    figures = stored["metrics"]
    assert figures["prior_heights"] == 2
    assert figures["prior_rms"] < 0.05
    assert 0.6 < figures["curl_excess"] < 1.6
    assert figures["difference_distances_px"][0] == 1
    height, sigma = read_image(Path("s/height.exr")), read_image(Path("s/height_sigma.exr"))
    assert height[20, 26] == pytest.approx(7.5, abs=0.05)
    assert np.nanmedian(sigma) == pytest.approx(figures["height_sigma"], rel=1e-4)
    np.testing.assert_array_equal(np.isnan(sigma), np.isnan(height))
    curl = read_image(Path("s/curl_deg.exr"))
    assert read_image(Path("s/curl.png")).shape == (ROWS, COLUMNS, 3)
    assert np.nanstd(curl) == pytest.approx(figures["curl_deg"], rel=0.3)


@pytest.mark.slow
def test_the_common_part_of_the_deviations_is_that_of_the_record(sgp, recording) -> None:
    """`sgp surface` on the normals of `sgp normals` states the errors that `sgp run` states."""
    lights = recording.parent / "lights.json"
    given = np.tile(np.radians(0.5) ** 2 * np.eye(2), (8, 1, 1))
    wrong = replace(ring_lights(), errors=LightErrors(given, np.zeros(8)))
    write_lights(lights, wrong)
    out = recording.parent / "out"
    scale = ("--pixel-mm", "0.5", "--height-sigma")
    assert sgp("run", recording, "--lights", lights, "--out", out, *scale).code == 0
    figures = json.loads((out / "normals" / "normals.json").read_text())["metrics"]
    assert figures["normal_sigma_common_deg"] > 0.1
    found = {}
    for name, folder in (("record", out / "normals"), ("none", recording.parent / "alone")):
        folder.mkdir(exist_ok=True)
        sigma = folder / "normal_sigma_deg.exr"
        if name == "none":
            shutil.copy(out / "normals" / "normal_sigma_deg.exr", sigma)
        surface = recording.parent / f"surface-{name}"
        answer = sgp("surface", out / "normals", "--sigma", sigma, *scale, "--out", surface)
        assert answer.code == 0, answer.err
        stored = json.loads((surface / "surface.json").read_text())["metrics"]
        found[name] = stored["difference_sigma"]
    run = json.loads((out / "surface" / "surface.json").read_text())["metrics"]["difference_sigma"]
    np.testing.assert_allclose(found["record"], run, rtol=0.3)  # weighted, and one value for all
    assert found["none"][-1] < 0.8 * run[-1]


@pytest.mark.parametrize(
    "discontinuity", quick([[], ["--discontinuity"]], every=2), ids=["plain", "jumps"]
)
def test_the_mean_height_above_the_working_plane(sgp, folder: Path, discontinuity) -> None:
    camera = bench_camera()
    write_normals("flat", NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (*camera.size, 1))))
    write_camera("camera.json", camera)
    words = ["surface", "flat", "--camera", "camera.json", "--height-mm", "12", *discontinuity]
    answer = sgp(*words, "--out", "s")
    assert answer.code == 0, answer.err
    np.testing.assert_allclose(read_image(Path("s/height.exr")), 12, atol=1e-3)


def bad(name: str, values: np.ndarray) -> None:
    write_exr(name, values.astype(np.float32))


def test_input_that_is_refused(sgp, folder: Path) -> None:
    """Every case is one line with the file or option, exit code, and no files."""
    size = (ROWS, COLUMNS)
    bad("small.exr", np.ones((5, 5)))
    bad("none.exr", np.full(size, np.nan))
    bad("negative.exr", np.full(size, -1))
    bad("shape.exr", np.ones((7, 30)))
    bad("large.exr", np.full(size, 181))
    assert sgp("surface", "n", "--out", "earlier").code == 0
    write_png("sigma.png", np.ones(size, np.uint16))
    Path("px.csv").write_text("x_px,y_px,height_px\n26,20,7.5\n")
    Path("far.csv").write_text("x_px,y_px,height_px\n900,20,7.5\n")
    Path("rim.csv").write_text("x_px,y_px,height_px\n0,0,7.5\n")
    write_camera("other.json", bench_camera())
    one = np.zeros(size, bool)
    write_mask("empty.png", one)
    one[20, 26] = True
    write_mask("one.png", one)
    cases = [
        (["--sigma", "small.exr"], "small.exr", 4),
        (["--sigma", "none.exr"], "none.exr", 4),
        (["--sigma", "negative.exr"], "negative.exr", 4),
        (["--sigma", "sigma.png"], "sigma.png", 4),
        (["--sigma", "large.exr"], "values up to 181", 4),
        (["--sigma", "earlier/height.exr"], "surface.json says that this is height", 4),
        (["--sigma", "missing.exr"], "missing.exr", 2),
        (["--prior", "px.csv", "--pixel-mm", "1"], "px.csv: the heights are in px", 4),
        (["--prior", "points.csv"], "points.csv: the heights are in mm", 4),
        (["--prior", "far.csv"], "far.csv: none of 1 points", 4),
        (["--prior", "rim.csv"], "inside the mask", 4),
        (["--prior", "shape.exr"], "shape.exr", 4),
        (["--prior", "missing.csv"], "missing.csv", 2),
        (["--prior-sigma", "1"], "give --prior too", 2),
        (["--height-sigma"], "give --sigma too", 2),
        (["--height-mm", "1"], "--height-mm needs a camera", 2),
        (["--camera", "other.json"], "other.json", 4),
        (["--mask", "empty.png"], "empty.png", 4),
        (["--mask", "one.png"], "nothing to integrate", 5),
    ]
    failed = []
    for words, text, code in cases:
        answer = sgp("surface", "n", *words, "--out", "out")
        lines = [line for line in answer.err.splitlines() if line.startswith("error")]
        if answer.code != code or len(lines) != 1 or text not in lines[0]:
            failed.append((words, answer.code, answer.err))
        if Path("out").exists() and any(Path("out").iterdir()):
            failed.append((words, "left files"))
    assert failed == []


def test_normals_without_a_deviation_are_counted(sgp, folder: Path) -> None:
    sigma = read_image(Path("sigma.exr")).copy()
    sigma[20, 20:23] = np.nan
    bad("gaps.exr", sigma)
    answer = sgp("surface", "n", "--sigma", "gaps.exr", "--out", "s")
    assert answer.code == 0
    assert "gaps.exr: 3 of " in answer.err
    assert " have no standard deviation, and count as the least certain ones" in answer.err


def test_normals_that_are_doubtful_are_reported(sgp, folder: Path) -> None:
    flat = np.tile([0.0, 0.0, 1.0], (ROWS, COLUMNS, 1)).astype(np.float32)
    away, holes, lengths = -flat, flat.copy(), flat.copy()
    holes[10:13, 10:13] = np.nan
    lengths[10:13, 10:13] *= 3
    write_mask("mask.png", np.ones((ROWS, COLUMNS), bool))
    cases = [(holes, 0, "normals-not-finite"), (lengths, 0, "normals-not-unit"), (away, 5, "")]
    for number, (values, code, notice) in enumerate(cases):
        write_exr("normals.exr", values)
        answer = sgp("surface", "normals.exr", "--out", f"out{number}")
        assert answer.code == code, answer.err
        if notice:
            stored = json.loads(Path(f"out{number}/surface.json").read_text(encoding="utf-8"))
            assert notice in {found["code"] for found in stored["notices"]}
    answer = sgp("surface", "n", "--mask", "mask.png", "--out", "larger")
    lost = ROWS * COLUMNS - np.count_nonzero(read_image(Path("n/mask.png")))
    assert f"mask.png: {lost} pixels of the mask have no normal in n, and no height" in answer.err
    write_png("flat.png", np.full((ROWS, COLUMNS, 3), (128, 128, 255), np.uint8))
    answer = sgp("surface", "flat.png", "--out", "quantised")
    assert answer.code == 0
    assert "8-bit normals are quantised, an error of about 0.2 degree" in answer.err


def test_a_run_without_known_noise_says_that_heights_have_no_deviations(sgp, tmp_path) -> None:
    """Four images do not show their noise."""
    (tmp_path / "images").mkdir()
    lights = ring_lights().take([0, 2, 4, 6])
    normals, mask = ball()
    write_lights(tmp_path / "lights.json", lights)
    write_png(tmp_path / "images" / "mask.png", mask.astype(np.uint8) * np.uint8(255))
    for index, light in enumerate(lights.unit_directions):
        samples = 50_000 * np.clip(normals @ light, 0, 1)
        write_png(tmp_path / "images" / f"b.{2 * index}.png", samples.astype(np.uint16))
    words = ("run", tmp_path / "images", "--lights", tmp_path / "lights.json", "--height-sigma")
    answer = sgp(*words, "--out", tmp_path / "out", "--json")
    assert answer.code == 0, answer.err
    assert "height-sigma-unknown" in answer.codes()
    assert not (tmp_path / "out" / "surface" / "height_sigma.exr").exists()


def test_a_camera_of_another_size_is_doubted(sgp, folder: Path) -> None:
    """A matrix without an image size: of twice and half the size, in mm, and the right one."""
    cases = [
        ((120, 51.5, 39.5), "far from the middle of an image of 52 x 40"),
        ((30, 13, 10), "far from the middle"),
        ((8, 25.5, 19.5), "too short for an image of 52 x 40"),
        ((60, 27, 18), None),
    ]
    for number, ((focal, cx, cy), text) in enumerate(cases):
        Path("K.txt").write_text(f"{focal} 0 {cx}\n0 {focal} {cy}\n0 0 1\n", encoding="ascii")
        answer = sgp("surface", "n", "--camera", "K.txt", "--out", f"out{number}", "--json")
        assert answer.code == 0, answer.err
        doubts = [one for one in json.loads(answer.out)["notices"] if one["where"] == "K.txt"]
        assert [one["code"] for one in doubts] == ([] if text is None else ["camera-doubtful"])
        assert text is None or text in doubts[0]["text"]
