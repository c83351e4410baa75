"""The tables of super-resolution: rows, notes, and errors on one map."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import acquisition
import processing
from benchmarks.paper import superres as bench
from benchmarks.paper import superres_maps, superres_peers
from benchmarks.paper import superres_tables as tables
from benchmarks.paper.__main__ import main
from benchmarks.paper.superres_judge import Judgement, judge
from benchmarks.paper.superres_maps import smooth
from processing import NormalMap
from sgp.training.judgement import Judgement as Judged

MODELS = Path(processing.__file__).parent / "superres" / "models"


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
    model = processing.superres.read_superres_model(None, 4)
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
    model = processing.superres.read_superres_model(None, 4)
    found = [("reliefs", name, judgement({"detail": changes})) for name, changes in SEEDS.items()]
    table = tables.domains(4, found, {"detail": [model]})
    assert [table.rows[name][1] for name in SEEDS] == pytest.approx([1, 2])
    assert table.rows["**reliefs**, mean of changes"][:2] == pytest.approx([-26, 1.5])


def test_domains_are_compared_only_between_networks_trained_alike() -> None:
    model = processing.superres.read_superres_model(None, 4)
    longer = dataclasses.replace(model, training=model.training | {"steps": 123_456})
    found = [("reliefs", "bark", judgement({"detail": [-30, -31], "normals": [-20, -21]}))]
    note = tables.domains(4, found, {"detail": [model], "normals": [longer]}).note
    assert "not trained alike" in note
    assert (
        "all networks are of one domain"
        in tables.domains(4, found, {"detail": [model]}).note.lower()
    )


def test_the_tables_have_a_row_for_each_map_and_class() -> None:
    model = processing.superres.read_superres_model(None, 4)
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
    own = processing.superres.read_superres_model(None, 4)
    one = judge(truth, own, {own.domain: [own]})
    assert 0 < one.own_deg < one.bicubic_deg
    cut = NormalMap(truth.normals[:64, :84].copy(), truth.mask[:64, :84].copy())
    low = processing.superres.low_resolution(cut, 4)
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
    assert bench.networks(None, 2) == {}
    assert {name: len(each) for name, each in bench.networks(None, 4).items()} == {
        "detail": 1,
        "normals": 1,
    }
    found = bench.networks(MODELS, 4)
    assert [model.name for each in found.values() for model in each] == ["superres-x4"]
    shutil.copy(MODELS / "superres-x4.onnx", tmp_path)
    with pytest.raises(acquisition.MissingPathError, match="superres-x4"):
        bench.networks(tmp_path, 4)


@pytest.fixture
def small(monkeypatch) -> None:
    """Use small and few surfaces."""
    for module, name, value in (
        (bench, "_COST_PX", 200),
        (bench, "_RANDOM_PX", 96),
        (bench, "_QUICK_RANDOM", 2),
        (superres_maps, "_QUICK_PX", 128),
        (superres_peers, "SIDE_PX", 128),
        (superres_peers, "_SEEDS", range(1000, 1001)),
        (superres_peers, "_HELD_OUT_PX", 96),
    ):
        monkeypatch.setattr(module, name, value)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_all_tables_are_written(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.delenv("SGP_DATA", raising=False)
    assert main(["--table", "superres", "--out", str(tmp_path), "--quick"]) == 0
    assert "warning: SGP_DATA is not set" in capsys.readouterr().err
    written = json.loads((tmp_path / "superres" / "tables.json").read_text(encoding="utf-8"))
    assert set(written) == {
        "errors_x4", "domains_x4", "deviations_x4", "cost", "systems_deg", "systems_ssim",
        "systems_px", "distances",
    }  # fmt: skip
    for name in smooth():
        bicubic, ours = written["errors_x4"]["rows"][name][:2]
        assert ours <= 1.01 * bicubic + 1e-4
