"""Scenes recorded from the command line: real sessions, with ground truth that commands find."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import Session, read_image, read_source
from sgp.sessions import metered_exposures
from simulator import SCENES, render, scene_named
from tests.cases import cases

SMALL = ("--size", "96x80", "--led-count", "8")
DISTANT = """
[object]
kind = "cap"
radius_mm = 70.0
height_mm = 25.0
[pattern]
kind = "even"
albedo = 0.6
[lights]
kind = "listed"
directions = [[1,0,1.5], [0.7,0.7,1.5], [0,1,1.5], [-0.7,0.7,1.5], [-1,0,1.5], [0,-1,1.5]]
intensities = [0.8, 0.9, 1.0, 1.1, 1.2, 1.0]
[lens]
kind = "orthographic"
width = 96
height = 80
pixel_mm = 2.0
"""


@pytest.fixture
def distant(tmp_path: Path) -> Path:
    path = tmp_path / "cap.toml"
    path.write_text(DISTANT, encoding="utf-8")
    return path


def test_a_session_is_recorded_and_compared_with_its_ground_truth(sgp, tmp_path):
    out = tmp_path / "coin"
    # In so few pixels, the blur of a real lens would hide the relief.
    report = sgp("simulate", "coin", "--out", out, *SMALL, "--sharp", "--json").report()
    assert report["outputs"]["session"] == str(out)
    assert (report["metrics"]["width"], report["metrics"]["height"]) == (96, 80)
    assert sgp("capture", "verify", out).code == 0
    session = Session.open(out)
    assert session.complete
    assert len([frame for frame in session.frames if frame.role == "light"]) == 8
    truth = out / "derived" / "truth"
    metrics = sgp(
        "normals", out, "--lights", truth / "lights.json", "--out", tmp_path / "n", "--json"
    ).figures()
    # Directions to near lights are exact only in the working plane: errors of a few tenths.
    assert metrics["mae_deg"] < 1.0
    assert metrics["coverage"] == 1.0
    assert metrics["pixels"] == report["metrics"]["pixels"]
    bound = read_image(truth / "cramer_rao.exr")
    known = bound[read_source(out).mask]
    assert 0 < np.median(known) < 1.0


def test_exposures_are_metered(sgp, tmp_path):
    out = tmp_path / "scene"
    answer = sgp("simulate", "coin-with-spheres", "--out", out, *SMALL, "--json")
    long_us, short_us = json.loads(answer.out)["metrics"]["exposures_us"]
    source = read_source(out)
    spheres = np.zeros(source.size, np.bool_)
    for path in (out / "derived" / "truth").glob("sphere_*.png"):
        spheres |= read_image(path) > 0
    white, black = source.white_level, source.black_level
    frames = {0: [], 1: []}
    for frame in source.frames:
        if frame.role == "light":
            assert frame.exposure_us == (long_us, short_us)[frame.bracket]
            frames[frame.bracket].append((frame.read() - black) / (white - black))
    brightest = np.max(frames[0], axis=0)[source.mask]
    assert 0.65 < np.quantile(brightest, 0.99) < 0.85
    assert 0.5 < np.max(frames[1], axis=0)[spheres].max() < 1.0


def test_exposures_can_be_given(sgp, tmp_path):
    out = tmp_path / "coin"
    words = ("simulate", "coin", "--out", out, *SMALL)
    assert sgp(*words, "--exposure-us", 3000, "--exposure-us", 500).code == 0
    assert {frame.exposure_us for frame in Session.open(out).frames} == {3000.0, 500.0}


@pytest.mark.slow
def test_seeds_and_noise(sgp, tmp_path):
    def frame(name: str, *words: object) -> np.ndarray:
        out = tmp_path / name
        assert sgp("simulate", "coin", "--out", out, *SMALL, *words).code == 0
        return read_image(out / "frames" / "L05_E0.tif").astype(np.int64)

    first, again, other = frame("a"), frame("b", "--seed", 0), frame("c", "--seed", 1)
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.5
    clean = frame("d", "--no-noise")
    spread = first - clean
    assert 0.5 < spread.std() < 40
    assert abs(spread.mean()) < 1.0


def test_a_scene_file_and_the_saved_scene_give_the_same_frames(sgp, distant, tmp_path):
    assert sgp("simulate", distant, "--out", tmp_path / "a").code == 0
    left = tmp_path / "a" / "derived" / "truth" / "scene.toml"
    assert sgp("simulate", left, "--out", tmp_path / "b").code == 0
    for name in ("L00_E0.tif", "L05_E0.tif"):
        first, second = (tmp_path / run / "frames" / name for run in "ab")
        assert first.read_bytes() == second.read_bytes()


def test_diligent_layout(sgp, distant, tmp_path):
    out = tmp_path / "cap"
    sgp("simulate", distant, "--out", out, "--format", "diligent", "--no-noise").ok()
    source = read_source(out)
    assert source.kind == "diligent"
    assert len(source.frames) == 6
    truth = out / "truth"
    np.testing.assert_allclose(source.normals_truth, read_image(truth / "normals.exr"), atol=1e-6)
    np.testing.assert_array_equal(source.mask, read_image(truth / "mask.png") > 0)
    # Normals of a spherical cap of radius 110.5 mm, seen along parallel rays, in closed form.
    rows, columns = np.nonzero(source.mask)
    x, y = 2.0 * (columns - 47.5), -2.0 * (rows - 39.5)
    sphere = (70.0**2 + 25.0**2) / 50.0
    z = np.sqrt(sphere**2 - x**2 - y**2)
    normals = np.stack([x, y, z], axis=1) / sphere
    np.testing.assert_allclose(source.normals_truth[source.mask], normals, atol=1e-6)
    intensities = np.array([0.8, 0.9, 1.0, 1.1, 1.2, 1.0])
    np.testing.assert_allclose(source.lights.intensities[:, 1], intensities)
    # Images are proportional to albedo, intensity and cosine: one factor for all of them.
    factors = []
    for frame, light, intensity in zip(
        source.frames, source.lights.unit_directions, intensities, strict=True
    ):
        cosine = normals @ light
        lit = cosine > 0.2
        factors.append(frame.read()[source.mask][lit] / (intensity * cosine[lit]))
    factors = np.concatenate(factors)
    assert factors.std() / factors.mean() < 2e-3
    judged = sgp("normals", out, "--method", "ls", "--out", tmp_path / "n", "--json")
    assert json.loads(judged.out)["metrics"]["mae_deg"] < 0.1
    assert not [path for path in out.iterdir() if path.name.startswith(".")]


def test_diligent_layout_of_near_lights_warns_of_the_loss(sgp, tmp_path):
    out = tmp_path / "coin"
    answer = sgp("simulate", "coin-with-spheres", "--out", out, *SMALL, "--format", "diligent").ok()
    assert "positions" in answer.err
    assert len(read_source(out).frames) == 8, "one image per light, for any number of brackets"


def test_list_names_every_scene(sgp):
    answer = sgp("simulate", "list").ok()
    lines = [line.split()[0] for line in answer.out.splitlines() if line.strip()]
    assert lines == list(SCENES)


@pytest.mark.slow
def test_contact_sheet(sgp, tmp_path, monkeypatch):
    monkeypatch.setattr("simulator.SCENES", {"coin": "", "spheres": ""})
    sheet = tmp_path / "sheet.png"
    assert sgp("simulate", "list", "--sheet", sheet).code == 0
    picture = read_image(sheet)[..., :3].astype(float)
    # The coin's normals are the blue part; they are redder on the right.
    left = picture[:, : picture.shape[1] // 3]
    coin = left[..., 2] > left[..., 0] + 40
    columns = np.flatnonzero(coin.any(axis=0))
    reds = [
        left[:, half, 0][coin[:, half]].mean() for half in np.split(columns, [len(columns) // 2])
    ]
    assert reds[1] > reds[0]
    assert columns.mean() == pytest.approx(left.shape[1] / 2, rel=0.1)
    # Both marks are complete.
    gold = np.all(np.abs(picture - (255, 215, 0)) < 60, axis=2)
    counts = [int(part.sum()) for part in np.array_split(gold, 3, axis=1)]
    assert counts[0] > 8
    assert counts[1] == pytest.approx(counts[0], abs=3)
    assert counts[2] == 0


@cases(
    ("words", "code", "message"),
    {
        "no folder": (["coin"], 2, "--out"),
        "unknown scene": (["coyn", "--out", "o"], 2, "sgp simulate list"),
        "missing file": (["nowhere.toml", "--out", "o"], 2, "nowhere.toml"),
        "bad file": (["bad.toml", "--out", "o"], 4, "[object]: unknown key 'radius'"),
        "half a size": (["coin", "--out", "o", "--size", "64"], 2, "640x512"),
        "no pixels": (["coin", "--out", "o", "--size", "0x5"], 2, "640x512"),
        "no lights": (["coin", "--out", "o", "--led-count", "0"], 2, "led-count"),
        "exposure": (["coin", "--out", "o", "--exposure-us", "-5"], 2, "exposure"),
        "unknown layout": (["coin", "--out", "o", "--format", "zip"], 2, "zip"),
        "folder with files": (["coin", "--out", "full"], 2, "full"),
        "folder that is a file": (["coin", "--out", "bad.toml"], 2, "bad.toml"),
        "sheet of one": (["coin", "--out", "o", "--sheet", "s.png"], 2, "list"),
        "list with a folder": (["list", "--out", "o"], 2, "--out"),
        "sheet of another type": (["list", "--sheet", "s.jpg"], 2, ".png"),
        "mosaic": (["bayer.toml", "--out", "o", "--format", "diligent"], 2, "mosaic"),
    },
)
def test_refusals(sgp, tmp_path, monkeypatch, words, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("years of work", encoding="utf-8")
    (tmp_path / "bad.toml").write_text(
        "[object]\nkind='coin'\nradius_mm=5\nradius=5\n", encoding="utf-8"
    )
    (tmp_path / "bayer.toml").write_text(DISTANT + "cfa = 'RGGB'\n", encoding="utf-8")
    line = sgp("simulate", *words).error_line(code)
    assert message in line
    assert "--force" not in line  # the command has no such option
    assert not (tmp_path / "o").exists()
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.txt"]


def test_metering_uses_the_quantum_efficiency():
    plain = render(scene_named("plane", width=48, height=40, leds=4))
    (exposure_us,) = metered_exposures(plain)
    noise = replace(plain.truth.noise, quantum_efficiency=0.5)
    dim = replace(plain, truth=replace(plain.truth, noise=noise))
    (longer_us,) = metered_exposures(dim)
    assert longer_us == pytest.approx(2 * exposure_us, rel=0.1)


def test_dead_leds_of_a_scene_are_skipped(sgp, tmp_path):
    scene = tmp_path / "dead.toml"
    scene.write_text(DISTANT + "[lamps]\ndead = [3]\n", encoding="utf-8")
    answer = sgp("simulate", scene, "--out", tmp_path / "s").ok()
    assert "LED 3 skipped: dead in the scene" in answer.err
    session = Session.open(tmp_path / "s")
    assert session.complete
    assert [frame.led for frame in session.frames if frame.role == "light"] == [0, 1, 2, 4, 5]
    assert sgp("simulate", scene, "--format", "diligent", "--out", tmp_path / "d").code == 0
    assert len((tmp_path / "d" / "light_directions.txt").read_text().splitlines()) == 5
    judged = sgp("normals", tmp_path / "d", "--out", tmp_path / "n", "--json")
    assert json.loads(judged.out)["metrics"]["mae_deg"] < 1.0


def test_a_bracket_too_short_for_the_object_does_not_stop_a_recording(sgp, distant, tmp_path):
    words = ("--exposure-us", "20000", "--exposure-us", "10")
    sgp("simulate", distant, "--out", tmp_path / "s", *words).ok()
    assert Session.open(tmp_path / "s").complete


@pytest.mark.slow
def test_with_little_memory_the_frames_and_the_truth_are_equal(sgp, tmp_path):
    scene = ("simulate", "coin-with-spheres", "--size", "64x52", "--led-count", "3")
    assert sgp(*scene, "--out", tmp_path / "whole").code == 0
    # Not enough for the 68 bytes of each pixel, but for a dozen rows.
    assert sgp(*scene, "--out", tmp_path / "bands", "--memory", "131230K").code == 0
    frames = [
        [frame.line.pixels_sha256 for frame in Session.open(tmp_path / name).frames]
        for name in ("whole", "bands")
    ]
    assert frames[0] == frames[1]
    whole, bands = (tmp_path / name / "derived" / "truth" for name in ("whole", "bands"))
    for path in (path for path in whole.rglob("*") if path.is_file()):
        assert (bands / path.relative_to(whole)).read_bytes() == path.read_bytes(), path
    line = sgp(*scene, "--out", tmp_path / "none", "--memory", "128M").error_line(4)
    assert "needs at least 135 MB of memory" in line
