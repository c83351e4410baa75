"""``sgp batch`` with roughness: results of the parts, their table, control charts, exit codes."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from acquisition import DataError, read_image
from sgp.batch import Recipe, control_charts, read_parts, roughness_table
from sgp.commands.batch import _task
from sgp.pictures import Series, individuals_limits
from sgp.results import Result, write_record
from tests.sgp.test_cli_batch import here, two  # noqa: F401

RECIPE = """
[run]
lights = "lights.json"
pixel-mm = 0.1
[roughness]
region = ["top=17,13,14,14"]
form = "level"
l-mm = 0
limits = "limits.toml"
"""


def limits(path: Path, most: float) -> None:
    path.write_text(f'[[limit]]\nparameter = "Sq"\nmost = {most}\n')


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "roughness.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_limits_of_an_individuals_chart() -> None:
    # Ranges 1, 2, 0, 1: mean 1.
    found = individuals_limits(np.array([10.0, 11.0, 9.0, 9.0, 10.0]))
    assert found == pytest.approx((9.8, 9.8 - 3 / 1.128, 9.8 + 3 / 1.128))
    assert individuals_limits(np.array([1.0, 2.0])) is None


def test_a_part_is_marked_beyond_a_control_limit_or_a_limit_of_the_specification() -> None:
    values = np.array([1.0, 1.1, 1.0, 1.1, 1.0, 1.1, 1.0, 9.0, 1.0, 1.1, 1.0, 1.1] + 8 * [1.0, 1.1])
    exceeded = np.zeros(len(values), bool)
    exceeded[2] = True
    series = Series("Sq", [str(n) for n in range(len(values))], values, 0 * values, exceeded)
    assert series.marked.nonzero()[0].tolist() == [2, 7]


def part(out: Path, name: str, value: float, day: int, answers=()) -> None:
    folder = out / "roughness" / name
    folder.mkdir(parents=True)
    found = {
        "name": "Sq", "unit": "um", "value": value, "sigma": 0.05, "measured": value,
        "budget": {}, "doubts": [],
    }  # fmt: skip
    metrics = {
        "pixel_mm": 0.1, "lens_blur_px": 0.76, "lateral_resolution_mm": 0.5,
        "regions": [
            {"name": "=seal", "kind": "area", "place": "0,0,9,9", "pixels": 81}
            | {"parameters": [found]}
        ],
        "limits": [
            {"parameter": "Sq", "region": "=seal", "least": None, "most": 2.0, "answer": one}
            for one in answers
        ],
    }  # fmt: skip
    path = folder / "roughness.json"
    write_record(path, "sgp roughness", {}, Result(metrics=metrics))
    content = json.loads(path.read_text())
    content["recordings"] = [{"started_utc": f"2026-03-{day:02}T00:00:00+00:00"}]
    path.write_text(json.dumps(content))


def test_the_table_has_a_row_for_each_limit_in_the_order_of_the_recordings(tmp_path) -> None:
    part(tmp_path, "late", 2.5, 9, ["exceeded", "undecided"])
    part(tmp_path, "early", 1.5, 3, ["conforms"])
    parts = read_parts(tmp_path, ["late", "early"])
    lines = list(csv.DictReader(roughness_table(parts).splitlines()))
    assert [(row["part"], row["answer"]) for row in lines] == [
        ("early", "conforms"), ("late", "exceeded"), ("late", "undecided"),
    ]  # fmt: skip
    assert lines[0]["region"] == "'=seal"  # no formula
    assert (lines[0]["value"], lines[0]["expanded_uncertainty_k2"]) == ("1.5", "0.1")
    (chart,) = control_charts(parts)
    assert chart.title == "=seal: Sq (um)"
    (tmp_path / "roughness" / "late" / "roughness.json").write_text("{}")
    with pytest.raises(DataError, match=r"roughness\.json"):
        read_parts(tmp_path, ["late"])


def test_roughness_of_a_recipe_follows_the_run() -> None:
    recipe = Recipe(roughness={"region": ["a=1,2,30,40", "{name}.png"], "l-mm": 0}, report={})
    task = _task("owl", Path("/r/owl"), recipe, Path("/out"), threads=1, attempts=1)
    assert task.lines() == [
        ["run", "/r/owl", "--out=/out/owl", "--force"],
        [
            "roughness", "/out/owl", "--out=/out/roughness/owl", "--force",
            "--region=a=1,2,30,40", "--region=owl.png", "--l-mm=0",
        ],
        ["report", "/out/owl", "--out=/out/owl/report.html", "--force"],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ('region = ["a=1,2,3"]', "--region a=1,2,3: is neither"),
        ('line = ["1,2,3"]', "--line 1,2,3: give"),
        ('limits = "wrong.toml"', "Sx is not a parameter"),
    ],
)
def test_wrong_places_and_limits_are_refused_before_any_work(
    sgp, recording, tmp_path, line, text
) -> None:
    (tmp_path / "wrong.toml").write_text('[[limit]]\nparameter = "Sx"\nmost = 1\n')
    recipe = tmp_path / "recipe.toml"
    recipe.write_text(f'[run]\nlights = "lights.json"\n[roughness]\n{line}\n')
    answer = sgp("batch", recording, "--out", tmp_path / "out", "--recipe", recipe)
    assert text in answer.error_line(2)


@pytest.mark.slow
def test_each_part_is_measured_and_limits_decide_the_exit_code(
    here,  # noqa: F811
    sgp,
    two,  # noqa: F811
    tmp_path,
) -> None:
    out, recipe = tmp_path / "out", tmp_path / "recipe.toml"
    recipe.write_text(RECIPE)
    words = ["batch", *two, "--out", out, "--recipe", recipe, "--json"]
    limits(tmp_path / "limits.toml", 1e6)
    assert sgp(*words).figures()["exceeded"] == 0
    assert {row["part"] for row in rows(out)} == {"ball", "bright"}
    assert sgp(*words).figures()["computed"] == 0
    limits(tmp_path / "limits.toml", 1e-6)
    answer = sgp(*words)
    assert answer.code == 6
    assert json.loads(answer.out)["metrics"] == {
        "sources": 2, "done": 2, "failed": 0, "computed": 2, "exceeded": 2,
    }  # fmt: skip
    stated = json.loads((out / "roughness" / "ball" / "roughness.json").read_text())["metrics"]
    sq = next(one for one in stated["regions"][0]["parameters"] if one["name"] == "Sq")
    (row,) = (one for one in rows(out) if (one["part"], one["parameter"]) == ("ball", "Sq"))
    assert float(row["value"]) == pytest.approx(sq["value"], rel=1e-5)
    assert (row["most"], row["answer"]) == ("1e-06", "exceeded")
    assert read_image(out / "roughness.png").ndim == 3
    page = (out / "index.html").read_text()
    assert "roughness of 2 parts: 2 beyond a limit (ball, bright), 0 undecided" in page
    assert 'href="roughness.csv"' in page
    (two[1] / "ball.3.png").write_bytes(b"no image")
    assert sgp(*words).code == 4
    recipe.write_text(RECIPE.partition("[roughness]")[0])
    assert sgp(*words).code == 4
    assert not (out / "roughness.csv").exists()
