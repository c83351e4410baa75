"""``sgp detail superres``: files, record, scale, and one line for bad input."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import acquisition
import processing
from acquisition import read_camera, read_image, write_camera, write_exr
from processing import NormalMap, read_normals, write_normals
from sgp._paper import superres as bench
from sgp._paper import superres_tables as tables
from sgp._paper.comparison import Comparison
from sgp._paper.superres_judge import Judgement, judge
from sgp._paper.superres_maps import smooth
from sgp._superres.judgement import Judgement as Judged
from simulator import bench_camera

MODELS = Path(processing.__file__).parent / "_superres" / "models"


@pytest.fixture(scope="module")
def low(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with normals of waves inside a mask, and other files."""
    folder = tmp_path_factory.mktemp("superres")
    y, x = np.mgrid[:30, :40]
    slopes = 0.3 * np.sin(x / 1.5 + np.sin(y / 4)), 0.3 * np.cos(y / 3)
    mask = np.ones((30, 40), np.bool_)
    mask[:, :10] = False
    waves = NormalMap.from_vectors(np.dstack([*slopes, np.ones((30, 40))]), mask)
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
    answer = sgp(*words, "--pixel-mm", 0.2, "--json")
    assert answer.code == 0, answer.err
    given = read_normals(low / "waves").normal_map
    made = processing.super_resolve(given, 4)
    high = read_normals(out / "normals.exr").normal_map
    np.testing.assert_allclose(high.normals, made.normal_map.normals, atol=1e-6)
    np.testing.assert_array_equal(read_image(out / "normal_sigma_deg.exr"), made.sigma_deg)
    invented = read_image(out / "invented.png")
    np.testing.assert_array_equal(invented, np.rint(made.invented * 255))
    record = json.loads((out / "superres.json").read_text(encoding="utf-8"))
    assert record["parameters"] | {"scale": 4, "self_ensemble": True} == record["parameters"]
    model = processing.read_superres_model(None, 4)
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
    answer = sgp("surface", out, "--sigma", sigma, "--out", tmp_path / "surface")
    assert answer.code == 0, answer.err


def test_bicubic_interpolation_and_a_camera(sgp, low: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ("detail", "superres", low / "waves", "--scale", 2, "--out", out)
    words = (*words, "--no-self-ensemble")
    answer = sgp(*words, "--method", "bicubic", "--camera", low / "camera.json")
    assert answer.code == 0, answer.err
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
        )
        assert answer.code == 0, answer.err
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
    answer = sgp("detail", "superres", *words, "--out", tmp_path / "out")
    assert answer.code == code, answer.err
    assert text in answer.err
    assert len(answer.err.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_normals_that_are_not_numbers_are_left_out(sgp, low: Path, tmp_path: Path) -> None:
    words = ("detail", "superres", low / "nan.exr", "--scale", 4, "--out", tmp_path / "out")
    answer = sgp(*words, "--method", "bicubic")
    assert answer.code == 0, answer.err
    assert "30 pixels have a NaN or infinite vector" in answer.err
    mask = read_normals(tmp_path / "out").normal_map.mask
    assert not mask[24:28, 88:112].any()
    assert mask[40:, 60:].all()


# The bench.


def judgement(changes: dict[str, list[float]]) -> Judgement:
    by_domain = {domain: [2 * (1 + c / 100) for c in each] for domain, each in changes.items()}
    heights = {"bicubic": 0.5, "own": 0.3} | dict.fromkeys(changes, 0.4)
    return Judgement(2.0, 1.5, by_domain, heights, [1.0] * 10, 0.1, 300)  # type: ignore[arg-type]


# Changes for two seeds of a training; their mean over the maps is -25.25 and -26.75 %.
SEEDS = {"bark": [-30, -31], "moss": [-20.5, -22.5]}


@pytest.mark.parametrize(
    ("detail", "normals", "text"),
    [
        ([-30, -31], [-20, -21], "worst seed is better than the best one on plain normals"),
        ([-20, -21], [-30, -31], "worst seed is better than the best one on details"),
        ([-20, -31], [-19, -30], "neither wins"),
        ([-20], [-30], "only one seed"),
    ],
)
def test_the_note_names_the_better_domain(detail, normals, text) -> None:
    model = processing.read_superres_model(None, 4)
    one = judgement({"detail": detail, "normals": normals})
    found = [("reliefs", "bark", one), ("smooth", "ball", one)]
    table = tables.domains(4, found, {"detail": [model], "normals": [model]})
    assert text in table.note
    spread = max(detail) - min(detail) if len(detail) > 1 else None
    assert table.rows["bark"][:3] == [
        pytest.approx(np.mean(detail)),
        None if spread is None else pytest.approx(spread),
        pytest.approx(-20),
    ]
    assert all(len(row) == len(table.columns) for row in table.rows.values())


def test_the_spread_of_a_class_is_that_of_its_mean() -> None:
    model = processing.read_superres_model(None, 4)
    found = [("reliefs", name, judgement({"detail": changes})) for name, changes in SEEDS.items()]
    table = tables.domains(4, found, {"detail": [model]})
    assert [table.rows[name][1] for name in SEEDS] == pytest.approx([1, 2])
    assert table.rows["**reliefs**, mean of changes"][:2] == pytest.approx([-26, 1.5])


def test_domains_are_compared_only_between_networks_trained_alike() -> None:
    model = processing.read_superres_model(None, 4)
    longer = dataclasses.replace(model, training=model.training | {"steps": 123_456})
    found = [("reliefs", "bark", judgement({"detail": [-30, -31], "normals": [-20, -21]}))]
    note = tables.domains(4, found, {"detail": [model], "normals": [longer]}).note
    assert "not trained alike" in note
    assert (
        "all networks are of one domain"
        in tables.domains(4, found, {"detail": [model]}).note.lower()
    )


def test_the_tables_have_a_row_for_each_map_and_class() -> None:
    model = processing.read_superres_model(None, 4)
    one = judgement({})
    larger = dataclasses.replace(one, bicubic_deg=6.0, own_deg=5.5, pixels=900)
    found = [("reliefs", "rel", one), ("captured", "cap", larger), ("smooth", "smo", one)]
    random = range(1000, 1010), Judged(2.5, 2.0, (0.9,) * 10)
    errors = tables.errors(model, found, random)
    change = pytest.approx(-25)
    assert errors.rows["rel"] == [2.0, 1.5, change, 0.5, 0.3, pytest.approx(-40)]
    assert errors.rows["random surfaces 1000 to 1009"][2] == pytest.approx(-20)
    both = "**reliefs and captured**"
    assert errors.rows[f"{both}, mean of changes"][2] == pytest.approx((-25 - 100 / 12) / 2)
    # (300 * 2 + 900 * 6) / 1200, and the same of 1.5 and 5.5.
    assert errors.rows[f"{both}, all pixels together"][:3] == pytest.approx([5, 4.5, -10])
    deviations = tables.deviations(4, found, random)
    assert deviations.rows["smo"] == [*one.ratios, 0.1]
    for table in (errors, deviations):
        assert all(len(row) == len(table.columns) for row in table.rows.values())


def test_a_map_is_judged_against_itself() -> None:
    y, x = np.mgrid[:66, :85]
    slopes = 0.3 * np.sin(x / 3 + np.sin(y / 8)), 0.3 * np.cos(y / 6)
    truth = NormalMap.from_vectors(np.dstack([*slopes, np.ones((66, 85))]))
    own = processing.read_superres_model(None, 4)
    one = judge(truth, own, {own.domain: [own]})
    assert 0 < one.own_deg < one.bicubic_deg
    cut = NormalMap(truth.normals[:64, :84].copy(), truth.mask[:64, :84].copy())
    low = processing.low_resolution(cut, 4)
    alone = processing.super_resolve(low, 4, self_ensemble=False).normal_map
    error = processing.angular_error(alone, cut)
    assert one.by_domain == {own.domain: [error.mae_deg]}
    assert one.change == pytest.approx(100 * (one.own_deg / one.bicubic_deg - 1))
    # Compared networks run without turned copies.
    assert one.changes(own.domain)[0] > one.change
    assert set(one.heights) == {"bicubic", "own", own.domain}
    assert one.pixels == cut.mask.sum()
    assert len(one.ratios) == 10


def test_networks_of_a_folder_are_those_of_the_scale(tmp_path) -> None:
    assert bench.networks(None, 4) == {}
    found = bench.networks(MODELS, 4)
    assert [model.name for each in found.values() for model in each] == ["superres-x4"]
    shutil.copy(MODELS / "superres-x4.onnx", tmp_path)
    with pytest.raises(acquisition.MissingPathError, match="superres-x4"):
        bench.networks(tmp_path, 4)


def test_options_of_the_bench_are_used(sgp, tmp_path, monkeypatch) -> None:
    asked = []

    def run(*, quick, seed, models, advance):
        asked.append((quick, seed, models))
        return Comparison("# Super-resolution")

    monkeypatch.setattr(bench, "run_superres", run)
    words = ("bench", "superres", "--out", tmp_path / "a")
    assert sgp(*words, "--quick", "--seed", 3, "--models", MODELS).code == 0
    assert asked == [(True, 3, MODELS)]
    answer = sgp("bench", "superres", "--out", tmp_path / "b", "--models", tmp_path / "none")
    assert answer.code == 2, answer.err


@pytest.mark.slow
def test_all_tables_of_the_bench_are_written(sgp, tmp_path, monkeypatch) -> None:
    monkeypatch.delenv("SGP_DATA", raising=False)
    answer = sgp("bench", "superres", "--out", tmp_path / "b", "--quick", "--json")
    assert answer.code == 0, answer.err
    written = json.loads((tmp_path / "b" / "tables.json").read_text(encoding="utf-8"))
    assert set(written) == {"errors_x4", "deviations_x4", "cost"}
    for name in smooth():
        bicubic, ours = written["errors_x4"]["rows"][name][:2]
        assert ours <= 1.01 * bicubic + 1e-4
    assert "SGP_DATA is not set" in answer.out
