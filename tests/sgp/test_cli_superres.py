"""``sgp detail superres``: files, record, scale, and one line for bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import processing
from acquisition import read_camera, read_image, write_camera, write_exr
from processing import read_normals, write_normals
from simulator import bench_camera
from tests.processing.scenes import folds

MODELS = Path(processing.__file__).parent / "superres" / "models"


@pytest.fixture(scope="module")
def low(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with normals of waves inside a mask, and other files."""
    folder = tmp_path_factory.mktemp("superres")
    waves = folds((30, 40), 1.5, np.s_[:, :10])
    write_normals(folder / "waves", waves)
    vectors = waves.normals.copy()
    vectors[5:8, 20:30] = np.nan
    write_exr(folder / "nan.exr", vectors)
    write_exr(folder / "empty.exr", np.zeros((30, 40, 3), np.float32))
    write_camera(folder / "camera.json", bench_camera().cropped(100, 100, 40, 30))
    return folder


def test_a_larger_map_with_its_record(sgp, low: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("detail", "superres", low / "waves", "--scale", 4, "--out", out)
    sgp(*words, "--pixel-mm", 0.2, "--json").ok()
    given = read_normals(low / "waves").normal_map
    made = processing.super_resolve(given, 4)
    high = read_normals(out / "normals.exr").normal_map
    np.testing.assert_allclose(high.normals, made.normal_map.normals, atol=1e-6)
    np.testing.assert_array_equal(read_image(out / "normal_sigma_deg.exr"), made.sigma_deg)
    invented = read_image(out / "invented.png")
    np.testing.assert_array_equal(invented, np.rint(made.invented * 255))
    record = json.loads((out / "superres.json").read_text(encoding="utf-8"))
    assert record["parameters"] | {"scale": 4, "self_ensemble": True} == record["parameters"]
    model = processing.superres.read_superres_model(None, 4)
    assert record["parameters"]["model"] == model.name
    assert record["inputs"][str(model.path)] == model.sha256
    metrics = record["metrics"]
    assert metrics["model_sha256"] == model.sha256
    assert (metrics["width"], metrics["height"]) == (160, 120)
    assert metrics["pixels"] == made.normal_map.mask.sum()
    assert metrics["invented_share"] == pytest.approx(made.invented_share)
    assert metrics["pixel_mm"] == pytest.approx(0.05)
    assert (out / "superres.png").stat().st_size > 10_000
    # The surface uses the deviations.
    sigma = out / "normal_sigma_deg.exr"
    sgp("surface", out, "--sigma", sigma, "--out", tmp_path / "surface").ok()


def test_bicubic_interpolation_and_a_camera(sgp, low: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("detail", "superres", low / "waves", "--scale", 2, "--out", out)
    words = (*words, "--no-self-ensemble")
    sgp(*words, "--method", "bicubic", "--camera", low / "camera.json").ok()
    assert not (out / "normal_sigma_deg.exr").exists()
    assert not read_image(out / "invented.png").any()
    record = json.loads((out / "superres.json").read_text(encoding="utf-8"))
    assert record["metrics"]["model_sha256"] is None
    assert record["metrics"]["normal_sigma_deg"] is None
    assert record["parameters"]["self_ensemble"] is False
    before = read_camera(low / "camera.json", (30, 40))
    after = read_camera(out / "camera.json", (60, 80))
    assert record["metrics"]["pixel_mm"] == pytest.approx(
        before.working_distance_mm / before.focal_px / 2
    )
    # The middle of the first pixel is the middle of the first four.
    rays = after.rays([[0.0, 0.0], [1.0, 1.0]]).mean(axis=0)
    np.testing.assert_allclose(rays, before.rays([[0.0, 0.0]])[0], atol=1e-9)
    np.testing.assert_allclose(after.downscaled(2).K, before.K, atol=1e-9)


@pytest.mark.slow
def test_the_map_of_a_projection_has_points(sgp, tmp_path: Path) -> None:
    y, x = np.mgrid[:7, :9].astype(float)
    corners = np.stack([x, y, 0.4 * np.sin(x + y)], axis=-1).reshape(-1, 3)
    quads = [(r * 9 + c, r * 9 + c + 1, r * 9 + c + 10, r * 9 + c + 9) for r, c in np.ndindex(6, 8)]
    lines = [f"v {a:g} {b:g} {c:g}" for a, b, c in corners]
    lines += ["f " + " ".join(str(one + 1) for one in quad) for quad in quads]
    (tmp_path / "wave.obj").write_text("\n".join(lines), encoding="utf-8")
    out = tmp_path / "map"
    assert sgp("project", tmp_path / "wave.obj", "--size", "36x28", "--out", out).code == 0
    given = read_normals(out).normal_map
    for sampling, words in {"points": [], "area": ["--sampling", "area"]}.items():
        folder = tmp_path / sampling
        answer = sgp(
            "detail", "superres", out / "normals.exr", "--scale", 2, "--out", folder, *words
        ).ok()
        record = json.loads((folder / "superres.json").read_text(encoding="utf-8"))
        assert record["parameters"]["sampling"] == sampling
        made = processing.super_resolve(given, 2, sampling=sampling)
        high = read_normals(folder / "normals.exr").normal_map
        np.testing.assert_allclose(high.normals, made.normal_map.normals, atol=1e-6)
        notices = [notice["code"] for notice in record["notices"]]
        assert notices == (["superres-points"] if sampling == "points" else [])
    (out / "project.json").unlink()
    words = ("detail", "superres", out, "--scale", 2, "--out", tmp_path / "unknown", "--json")
    answer = json.loads(sgp(*words).out)
    assert [notice["code"] for notice in answer["notices"]] == ["superres-means-assumed"]
    record = json.loads((tmp_path / "unknown" / "superres.json").read_text(encoding="utf-8"))
    assert record["parameters"]["sampling"] == "area"


BAD = {
    "scale 3": (["waves", "--scale", "3"], 2, "3"),
    "no scale": (["waves"], 2, "--scale"),
    "lost network": (["waves", "--scale", "4", "--model", "lost.onnx"], 2, "lost.onnx"),
    "unknown name": (["waves", "--scale", "4", "--model", "big"], 4, "no network 'big'"),
    "other scale": (["waves", "--scale", "2", "--model", "superres-x4"], 4, "is for scale 4"),
    "altered": (["waves", "--scale", "4", "--model", "altered.onnx"], 4, "or altered"),
    "bicubic network": (
        ["waves", "--scale", "4", "--method", "bicubic", "--model", "superres-x4"],
        2,
        "uses no network",
    ),
    "two scales": (
        ["waves", "--scale", "4", "--pixel-mm", "1", "--camera", "camera.json"],
        2,
        "leave --pixel-mm out",
    ),
    "no normals": (["empty.exr", "--scale", "4"], 4, "empty.exr"),
    "missing": (["none", "--scale", "4"], 2, "none"),
    "too large": (["waves", "--scale", "4", "--max-pixels", "1199"], 4, "40 x 30 pixels, 1199"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line(sgp, low: Path, tmp_path: Path, monkeypatch, case: str) -> None:
    words, code, text = BAD[case]
    monkeypatch.chdir(low)
    shutil.copy(MODELS / "superres-x4.json", low / "altered.json")
    (low / "altered.onnx").write_bytes((MODELS / "superres-x4.onnx").read_bytes()[:-1])
    assert text in sgp("detail", "superres", *words, "--out", tmp_path / "out").error_line(code)
    assert not (tmp_path / "out").exists()


def test_normals_that_are_not_numbers_are_left_out(sgp, low: Path, tmp_path: Path) -> None:
    words = ("detail", "superres", low / "nan.exr", "--scale", 4, "--out", tmp_path / "out")
    assert "30 pixels have a NaN or infinite vector" in sgp(*words, "--method", "bicubic").ok().err
    mask = read_normals(tmp_path / "out").normal_map.mask
    assert not mask[24:28, 88:112].any()
    assert mask[40:, 60:].all()
