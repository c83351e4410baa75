"""The tables of synthesised sheets: what they contain, and that tiles lose."""

from __future__ import annotations

import json

import numpy as np
import pytest

import processing
from benchmarks.paper import exemplars, sheets, synthesis_peers
from benchmarks.paper.__main__ import main
from benchmarks.paper.sources import Sources
from rig import no_progress
from sgp import read_record


@pytest.fixture
def small(monkeypatch):
    """Use small exemplars and sheets, and no data."""
    monkeypatch.delenv("SGP_DATA", raising=False)
    # Those of the trained peer have the size that it was trained on.
    whole = {name: synthesis_peers.exemplar_of(name) for name in synthesis_peers.trained()}
    monkeypatch.setattr(synthesis_peers, "exemplar_of", whole.__getitem__)
    monkeypatch.setattr(exemplars, "SIDE_PX", 72)
    monkeypatch.setattr(sheets, "_QUICK_SIDE_PX", 200)
    monkeypatch.setattr(sheets, "_SAME_MPX", 0.02)
    monkeypatch.setattr(sheets, "_BOWL_POINTS", 3000)
    given = sheets.materials

    def materials(seed: int) -> dict[str, processing.NormalMap]:
        return {"leather": given(seed)["leather"]}

    monkeypatch.setattr(sheets, "materials", materials)


def test_tiles_repeat_and_sheets_do_not(monkeypatch):
    monkeypatch.setattr(exemplars, "SIDE_PX", 64)
    monkeypatch.setattr(sheets, "PATCH_PX", 24)
    leather = exemplars.materials(3)["leather"]
    table, panels = sheets._quality("sheets", {"leather": leather}, 200, no_progress)
    assert len(panels) == 4
    made = {label: dict(zip(table.columns, row, strict=True)) for label, row in table.rows.items()}
    ours = made["leather, synthesised"]
    assert ours["over the exemplar's"] == pytest.approx(1, abs=0.15)
    assert made["leather, plain tiles"]["repeat score"] == pytest.approx(1, abs=1e-3)
    for label in ("leather, plain tiles", "leather, mirrored tiles"):
        assert made[label]["repeat score"] > ours["repeat score"] + 0.3
    plain = made["leather, plain tiles"]["step at borders over inside"]
    assert plain > 1.3 > ours["step at borders over inside"]


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_all_tables_are_written(tmp_path, capsys):
    assert main(["--table", "synthesis", "--out", str(tmp_path), "--quick"]) == 0
    assert "warning: SGP_DATA is not set" in capsys.readouterr().err
    assert read_record(tmp_path / "synthesis" / "bench.json").metrics["tables"] == 6
    tables = json.loads((tmp_path / "synthesis" / "tables.json").read_text(encoding="utf-8"))
    text = (tmp_path / "synthesis" / "tables.md").read_text(encoding="utf-8")
    assert set(tables) == {
        "sheets",
        "structured",
        "efros_leung",
        "cost",
        "onto_target",
        "synthesis_systems",
    }
    # Only the cost, and what the systems have on other targets, is printed in the paper.
    assert text.count("The paper:") == 2
    for table in tables.values():
        assert table["title"] in text
        assert all(len(row) == len(table["columns"]) for row in table["rows"].values())
    again = tables["onto_target"]["rows"]["SSIM of the detail separated again, mask only"]
    assert 0.9 < again[0] < 1
    assert tables["cost"]["paper_rows"] == {"1.67 million vertices": [11.88, 857.0]}
    assert list(tables["cost"]["rows"]) == ["0.02 million pixels"]
    for name in ("sheets", "structured", "height_profile"):
        assert (tmp_path / "synthesis" / f"{name}.png").stat().st_size > 10_000


def test_a_drawn_exemplar_has_no_slope_on_its_bricks():
    bricks = exemplars.structured()["bricks"]
    level = (bricks.normals[..., 2] > 1 - 1e-6).mean()
    assert 0.3 < level < 0.7
    # The light parts of both halves of a joint slope against each other.
    assert np.abs(bricks.normals[..., :2].mean(axis=(0, 1))).max() < 0.01


def test_materials_differ_by_seed_and_without_data_nothing_was_captured():
    first, second = exemplars.materials(1), exemplars.materials(2)
    assert all(not np.array_equal(first[name].normals, second[name].normals) for name in first)
    assert list(exemplars.captured(Sources(None), complete=True)) == []
