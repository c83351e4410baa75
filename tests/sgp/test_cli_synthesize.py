"""``sgp detail synthesize``: files, record, figures, and errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from acquisition import read_image, write_exr, write_png
from processing import NormalMap, combine, read_normals, separate, write_normals
from tests.cases import cases
from tests.processing.scenes import folds

NAMES = ("normals", "detail")


@pytest.fixture(scope="module")
def exemplar(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with normals of waves, with a hole at its rim."""
    folder = tmp_path_factory.mktemp("exemplar") / "waves"
    write_normals(folder, folds((80, 90), 2.5, np.s_[:10, :10]))
    return folder


def test_a_sheet_with_its_record(sgp, exemplar: Path, tmp_path: Path) -> None:
    out = tmp_path / "sheet"
    options = ("--size", "150x100", "--patch", 20, "--seed", 4, "--tileable", "--rotate")
    answer = sgp("detail", "synthesize", exemplar, *options, "--out", out, "--json").ok()
    sheet = read_normals(out / "detail.exr").normal_map
    assert sheet.size == (100, 150)
    assert sheet.mask.all()
    assert (read_image(out / "invented.png") == 255).all()
    record = json.loads((out / "synthesize.json").read_text(encoding="utf-8"))
    assert record["parameters"]["seed"] == 4
    assert record["inputs"]
    metrics = json.loads(answer.out)["metrics"]
    assert metrics["cut_step_deg"] < 1.5 * metrics["inside_step_deg"]
    sgp("detail", "synthesize", exemplar, *options, "--out", tmp_path / "again").ok()
    same = read_normals(tmp_path / "again" / "detail.exr").normal_map
    np.testing.assert_array_equal(same.normals, sheet.normals)


def test_detail_on_a_target(sgp, exemplar: Path, tmp_path: Path) -> None:
    y, x = np.mgrid[1:-1:60j, -1:1:70j]
    bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]), np.hypot(x, y) < 1)
    target, out = tmp_path / "bowl", tmp_path / "out"
    target.mkdir()
    write_normals(target, bowl)
    words = ("detail", "synthesize", exemplar, "--onto", target, "--patch", 20)
    sgp(*words, "--out", out, "--json").ok()
    normals, detail = (read_normals(out / f"{name}.exr").normal_map for name in NAMES)
    np.testing.assert_array_equal(normals.mask, bowl.mask)
    np.testing.assert_array_equal(read_image(out / "invented.png") > 0, bowl.mask)
    shape = separate(bowl).shape
    np.testing.assert_allclose(normals.normals, combine(shape, detail).normals, atol=1e-6)
    record = json.loads((out / "synthesize.json").read_text(encoding="utf-8"))
    assert record["metrics"]["shape_mae_deg"] < 3
    assert record["metrics"]["compressed_share"] == 0
    kept = tmp_path / "kept"
    assert sgp(*words, "--keep-target-detail", "--image-space", "--out", kept).code == 0
    normals, detail = (read_normals(kept / f"{name}.exr").normal_map for name in NAMES)
    np.testing.assert_allclose(normals.normals, combine(bowl, detail).normals, atol=1e-6)


def test_pixel_by_pixel(sgp, exemplar: Path, tmp_path: Path) -> None:
    words = ("detail", "synthesize", exemplar, "--crop", "20,20,24,24", "--method", "efros-leung")
    answer = sgp(*words, "--size", "20x14", "--patch", 5, "--out", tmp_path / "out", "--json").ok()
    assert read_normals(tmp_path / "out" / "detail.exr").normal_map.size == (14, 20)
    assert json.loads(answer.out)["metrics"]["cut_step_deg"] is None
    assert "odd" in sgp(*words, "--size", "9x9", "--patch", 6, "--out", "o").error_line(4)


def test_maps_that_guide_a_pattern(sgp, exemplar: Path, tmp_path: Path, monkeypatch) -> None:
    """Painted maps and maps of floats with the same values give the same detail."""
    monkeypatch.chdir(tmp_path)
    size = (60, 70)
    write_normals(tmp_path, NormalMap.from_vectors(np.tile([0.0, 0, 1], (*size, 1))), "flat")
    steps = np.where(np.arange(70) < 35, 51, 102).astype(np.uint8)
    painted = np.ascontiguousarray(np.broadcast_to(steps, size))
    write_png("painted.png", painted)
    write_exr("degrees.exr", np.float32(180 / 255) * painted)
    write_exr("factors.exr", np.exp2(2 * np.float32(1 / 255) * painted - 1))
    write_png("guide.png", np.tile(np.arange(90, dtype=np.uint8), (80, 1)))
    words = ("detail", "synthesize", exemplar, "--onto", "flat.exr", "--patch", 16)
    for out, direction, scale in (
        ("a", "painted.png", "painted.png"),
        ("b", "degrees.exr", "factors.exr"),
    ):
        options = ("--direction", direction, "--scale-map", scale, "--out", out)
        guides = ("--guide", "painted.png", "--guide-exemplar", "guide.png")
        assert sgp(*words, *options, *guides).code == 0
    first, second = (read_normals(tmp_path / out / "detail.exr").normal_map for out in "ab")
    np.testing.assert_allclose(first.normals, second.normals, atol=1e-3)
    record = json.loads((tmp_path / "a" / "synthesize.json").read_text(encoding="utf-8"))
    assert {Path(path).name for path in record["inputs"]} >= {"painted.png", "guide.png"}
    assert sgp(*words, "--direction", "curvature", "--out", "c").code == 0
    assert "70 x 60" in sgp(*words, "--scale-map", "guide.png", "--out", "d").error_line(4)
    pair = ("--guide", "painted.png", "--guide-exemplar")
    assert "90 x 80" in sgp(*words, *pair, "painted.png", "--out", "d").error_line(4)
    assert "floats" in sgp(
        *words, "--guide", "degrees.exr", "--guide-exemplar", "guide.png", "--out", "d"
    ).error_line(4)
    assert "channels" in sgp(*words, "--direction", "flat.png", "--out", "d").error_line(4)
    assert not (tmp_path / "d").exists()


@cases(
    ("options", "code", "text"),
    {
        "neither": ([], 2, "either --size"),
        "both": (["--size", "9x9", "--onto", "."], 2, "either --size"),
        "image space": (["--size", "9x9", "--image-space"], 2, "require --onto"),
        "detail": (["--size", "9x9", "--keep-target-detail"], 2, "require --onto"),
        "tileable": (["--onto", ".", "--tileable"], 2, "--tileable"),
        "missing target": (["--onto", "nowhere"], 2, "nowhere"),
        "method": (["--size", "9x9", "--method", "efros-leung", "--mirror"], 2, "require --method"),
        "direction": (["--size", "9x9", "--direction", "curvature"], 2, "require --onto"),
        "one guide": (["--onto", ".", "--guide", "."], 2, "require each other"),
        "missing map": (["--onto", ".", "--scale-map", "absent.exr"], 2, "absent"),
        "no pixels": (["--size", "0x10"], 2, "--size"),
        "no numbers": (["--size", "wide"], 2, "--size"),
        "beyond memory": (["--size", "99999999x99999999"], 2, ""),
        "crop outside": (["--size", "64x64", "--crop", "80,70,40,40"], 2, "--crop"),
        "crop of a hole": (["--size", "64x64", "--crop", "0,0,8,8"], 2, "no normal"),
        "small patch": (["--size", "64x64", "--patch", 5], 4, "too small"),
        "patch beyond exemplar": (["--size", "64x64", "--patch", 85], 4, "patch"),
        "overlap": (["--size", "64x64", "--overlap", 40], 4, "overlap"),
        "too small for tiling": (["--size", "60x64", "--tileable"], 4, "tiling"),
    },
)
def test_bad_options(sgp, exemplar: Path, tmp_path: Path, options, code: int, text: str) -> None:
    answer = sgp("detail", "synthesize", exemplar, *options, "--out", tmp_path / "out")
    assert text in answer.error_line(code)
    assert not (tmp_path / "out").exists()


def test_a_flat_exemplar_and_one_with_shape(sgp, tmp_path: Path) -> None:
    flat = tmp_path / "flat"
    flat.mkdir()
    write_normals(flat, NormalMap.from_vectors(np.tile([0.0, 0, 1], (64, 64, 1))))
    assert "flat" in sgp(
        "detail", "synthesize", flat, "--size", "64x64", "--out", tmp_path / "out"
    ).error_line(4)
    tilted = tmp_path / "tilted"
    tilted.mkdir()
    noise = np.random.default_rng(1).normal(scale=0.1, size=(64, 64, 3))
    write_normals(tilted, NormalMap.from_vectors(noise + np.array([0.5, 0, 1])))
    options = ("--is-detail", "--size", "64x64", "--patch", 16, "--json")
    answer = sgp("detail", "synthesize", tilted, *options, "--out", tmp_path / "out").ok()
    assert "exemplar-with-shape" in answer.codes()
