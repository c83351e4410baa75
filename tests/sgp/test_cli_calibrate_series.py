"""``sgp calibrate check`` with three or more calibrations: table, files, exit codes, refusals."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from acquisition import Lights, read_image, write_lights
from acquisition.values import Calibrated
from sgp import read_record
from tests.cases import cases
from tests.sgp.test_cli_calibrate_check import lights

START = datetime(2026, 1, 5, 10, tzinfo=UTC)


def calibrations() -> list[Lights]:
    """Return six calibrations of 12 lights, of which L03 fades."""
    rng, before = np.random.default_rng(0), lights()
    positions, fading = np.asarray(before.positions_mm), np.ones(12)
    found = []
    for k in range(6):
        fading[3] = 0.9**k
        strengths = np.linspace(1, 2, 12) * fading * np.exp(rng.normal(0, 0.002, 12))
        found.append(
            replace(
                before,
                positions_mm=positions + rng.normal(0, 0.2, (12, 3)),
                intensities=strengths,
                calibrated=Calibrated(START + timedelta(days=30 * k)),
            )
        )
    return found


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, value in zip("cabfed", calibrations(), strict=True):
        write_lights(tmp_path / f"{name}.json", value)
        write_lights(tmp_path / f"{name}-undated.json", replace(value, calibrated=None))
        equal = replace(value, intensities=None)
        write_lights(tmp_path / f"{name}-equal.json", equal)
    write_lights(tmp_path / "few.json", lights(11))
    write_lights(tmp_path / "distant.json", calibrations()[3].distant())
    write_lights(tmp_path / "again.json", replace(calibrations()[0], intensities=None))
    places = np.asarray(calibrations()[1].positions_mm)[[1, 0, *range(2, 12)]]
    late = Calibrated(START + timedelta(days=300))
    swapped = replace(calibrations()[2], positions_mm=places, calibrated=late)
    write_lights(tmp_path / "swapped.json", swapped)
    (tmp_path / "cut.json").write_text((tmp_path / "a.json").read_text()[:200])
    return tmp_path


ALL = "a.json b.json c.json d.json e.json f.json"


def test_table_chart_and_record(sgp: Callable[..., object], folder: Path) -> None:
    answer = sgp("calibrate", "check", *ALL.split(), "--out", "drift")
    assert answer.code == 4
    assert "1 light of 12 is beyond the limits: L03 (strength +" in answer.err
    lines = answer.out.splitlines()
    assert lines[0] == "6 calibrations of 12 lights, in the order of their dates"
    assert [line.split()[0] for line in lines[2:8]] == [f"{name}.json" for name in "cabfed"]
    assert "  c.json                      2026-01-05" in lines[2]
    assert "* L03" in answer.out
    assert max(map(len, lines)) <= 80
    record = read_record("drift/check.json")
    assert record.command == "sgp calibrate check"
    assert {*record.inputs} == {*ALL.split()}
    assert {path.name for path in (folder / "drift").iterdir()} == {
        "check.json", "drift.csv", "drift.png",
    }  # fmt: skip
    assert read_image("drift/drift.png").ndim == 3
    rows = list(csv.DictReader(Path("drift/drift.csv").read_text().splitlines()))
    assert len(rows) == 6 * 13
    out = {row["light"] for row in rows if abs(float(row["strength_of_limit"] or 0)) > 1}
    assert out == {"L03"}
    assert all(float(row["direction_of_limit"]) < 1 for row in rows)
    fading = [float(row["strength_percent"]) for row in rows if row["light"] == "L03"]
    assert fading == sorted(fading, reverse=True)
    assert rows[0]["time_utc"] == "2026-01-05T10:00:00+00:00"


def test_figures(sgp: Callable[..., object], folder: Path) -> None:
    answer = sgp("calibrate", "check", *ALL.split(), "--limit-percent", "60", "--json")
    metrics = answer.report()["metrics"]
    assert (metrics["lights"], metrics["beyond"], metrics["moved"]) == (12, 0, False)
    (fading,) = (one for one in metrics["drifts"] if one["id"] == "L03")
    assert 20 < fading["strength_percent"] < 60
    assert not fading["beyond"]
    assert [one["name"] for one in metrics["calibrations"]][:2] == ["c.json", "a.json"]
    equal = [f"{name}-equal.json" for name in "cab"]
    answer = sgp("calibrate", "check", *equal, "a-undated.json").ok()
    assert "intensities are not compared: those of c-equal.json, a-equal.json" in answer.out
    assert "in the order of the arguments, because dates are missing" in answer.out
    assert "stable: all values are within the limits" in answer.out
    assert (
        "4 calibrations do not distinguish a change that continues from scatter; a turn"
        in answer.err
    )


@cases(
    ("changed", "expected"),
    {
        "left out": (
            lambda one: one.take([n for n in range(12) if n not in (3, 7)]),
            "not all calibrations have L03, L07: not compared",
        ),
        "other names": (
            lambda one: replace(one, ids=tuple(f"p{n}.jpg" for n in range(12))),
            "lights with different names are matched by order (p0.jpg to L00 and so on)",
        ),
    },
)
def test_lights_that_do_not_correspond_are_named(
    sgp: Callable[..., object], folder: Path, changed: Callable[[Lights], Lights], expected: str
) -> None:
    write_lights(folder / "d.json", changed(calibrations()[5]))
    assert expected in sgp("calibrate", "check", *ALL.split()).err


@cases(
    ("words", "code", "expected"),
    {
        "same file": ("a.json b.json ./a.json", 2, "a.json and a.json are the same file: give ea"),
        "same date": ("c.json b.json again.json", 4, "state the same date, 2026-01-05 10:00:00"),
        "same lights": ("a.json b.json a-undated.json", 4, "a.json and a-undated.json have the sa"),
        "dates": ("b.json a.json c-undated.json", 4, "a.json is older than b.json, wh"),
        "count": ("a.json b.json few.json", 4, "few.json: the first calibration has 12 lights, th"),
        "kind": ("a.json b.json distant.json", 4, "a.json has positions, distant.json directions"),
        "order": ("a.json b.json f.json swapped.json", 4, "swapped.json has another order than a."),
        "unreadable": ("a.json cut.json b.json", 4, "cut.json"),
        "missing": ("a.json b.json none.json", 2, "none.json: no such file"),
        "rig": ("a.json b.json c.json --rig simulated", 2, "--rig is for one calibration"),
        "mm": ("a.json b.json c.json --limit-mm 1", 2, "--limit-mm is for two calibrations"),
        "out": ("a.json b.json --out x", 2, "--out is for a series: give three lights files"),
        "percent": (
            "a-equal.json b-equal.json c.json --limit-percent 1",
            2,
            "--limit-percent: fewer than 3 of these files have measured intensities",
        ),
    },
)  # fmt: skip
def test_refused(
    sgp: Callable[..., object], folder: Path, words: str, code: int, expected: str
) -> None:
    assert expected in sgp("calibrate", "check", *words.split()).error_line(code)
    assert not (folder / "x").exists()
