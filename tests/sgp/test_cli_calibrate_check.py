"""``sgp calibrate check``: exit codes, table, refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition import LightErrors, Lights, write_lights
from tests.cases import cases

Sgp = Callable[..., "object"]


def lights(count: int = 12) -> Lights:
    rng = np.random.default_rng(0)
    around, rise = 2 * np.pi * np.arange(count) / count, np.radians([30, 50, 70] * count)[:count]
    towards = [np.cos(rise) * np.cos(around), np.cos(rise) * np.sin(around), np.sin(rise)]
    covariances = np.tile(0.04 * np.eye(3), (count, 1, 1))
    return Lights(
        positions_mm=450 * np.stack(towards, axis=1) + rng.normal(0, 4, (count, 3)),
        errors=LightErrors(covariances=covariances, intensity_std=np.full(count, 0.002)),
    )


def moved(led: int = 5, by: tuple[float, float, float] = (0, 3, 4)) -> Lights:
    before = lights()
    assert before.positions_mm is not None
    positions = before.positions_mm.copy()
    positions[led] += by
    return replace(before, positions_mm=positions)


SWAPPED = replace(lights(), positions_mm=np.asarray(lights().positions_mm)[[*range(10), 11, 10]])
UNEVEN = replace(lights(), intensities=np.linspace(1, 2, 12))
DIMMER = replace(UNEVEN, intensities=2 * np.linspace(1, 2, 12) * ([1] * 3 + [0.55] + [1] * 8))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    files = {
        "a": lights(),
        "copy": lights(),
        "moved": moved(),
        "swapped": SWAPPED,
        "dimmer": DIMMER,
        "uneven": UNEVEN,
        "same": UNEVEN,
        "few": lights(11),
        "distant": lights().distant(),
        "photos": replace(lights(), ids=tuple(f"p{n}.jpg" for n in range(12))),
    }
    for name, value in files.items():
        write_lights(tmp_path / f"{name}.json", value)
    (tmp_path / "day2").mkdir()
    write_lights(tmp_path / "day2" / "a.json", moved())
    text = (tmp_path / "a.json").read_text().replace('"mu": 0.0', '"mu": NaN', 1)
    (tmp_path / "nan.json").write_text(text)
    rows = np.round(np.asarray(lights().positions_mm), -1).tolist()
    head = 'name = "dome one"\ndriver = "bench"\nleds = 12\n'
    (tmp_path / "rig.toml").write_text(f"{head}led_positions_mm = {rows}\n")
    rows[10], rows[11] = rows[11], rows[10]
    (tmp_path / "swapped.toml").write_text(f"{head}led_positions_mm = {rows}\n")
    (tmp_path / "bare.toml").write_text(head)
    return tmp_path


@cases(
    ("words", "code", "expected"),
    {
        "unmeasured": ("a.json copy.json", 0, ["of a.json and copy.json are all"]),
        "equal": ("uneven.json same.json", 0, ["no common factor"]),
        "the same name": ("a.json day2/a.json", 0, ["day2/a.json against "]),
        "no limit": ("a.json moved.json", 0, ["L05", "5.00 mm", "17.7"]),
        "within": ("a.json moved.json --limit-mm 5.1", 0, ["within the limits"]),
        "mm": ("a.json moved.json --limit-mm 4.9", 4, ["1 of 12 lights is beyond"]),
        "deg": ("a.json moved.json --limit-deg .3", 4, ["* L05"]),
        "percent": ("uneven.json dimmer.json --limit-percent 40", 4, ["-45.0 %", "of 2 was"]),
        "intensities of one": (
            "a.json uneven.json",
            0,
            ["0.000 deg", "not compared: those of a.json are all equal"],
        ),
        "swapped": ("a.json swapped.json", 4, ["LED 10 and 11 are swapped"]),
        "rig": ("a.json --rig rig.toml", 0, ["the rig dome one"]),
        "directions": ("distant.json --rig rig.toml", 0, ["the rig dome one"]),
        "wires": ("a.json --rig swapped.toml", 4, ["LED 10 and 11 are swapped"]),
    },
)
def test_verdict(
    sgp: Callable[..., object],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    code: int,
    expected: list[str],
) -> None:
    monkeypatch.chdir(folder)
    answer = sgp("calibrate", "check", *words.split())
    assert answer.code == code, answer.err
    for text in expected:
        assert text in answer.out + answer.err
    assert max(map(len, answer.out.splitlines())) <= 80


@cases(
    ("words", "code", "expected"),
    {
        "same file": ("a.json a.json", 2, "are the same file"),
        "same file, other path": ("a.json ./a.json", 2, "are the same file"),
        "one file": ("a.json", 2, "give a second lights file, or --rig"),
        "both": ("a.json moved.json --rig rig.toml", 2, "or --rig"),
        "missing": ("a.json none.json", 2, "none.json: no such file"),
        "first missing": ("none.json a.json", 2, "none.json: no such file"),
        "other number": ("a.json few.json", 4, "has 12 lights, the second 11"),
        "kind": ("a.json distant.json", 4, "has positions, the second directions"),
        "NaN": ("a.json nan.json", 4, "nan.json"),
        "NaN limit": ("a.json moved.json --limit-mm nan", 2, "--limit-mm"),
        "zero limit": ("a.json moved.json --limit-mm 0", 2, "--limit-mm"),
        "no mm": ("distant.json --rig rig.toml --limit-mm 3", 2, "--limit-deg"),
        "percent": ("a.json --rig rig.toml --limit-percent 3", 2, "no intensities"),
        "no strengths": ("a.json uneven.json --limit-percent 9", 2, "of a.json are"),
        "unmeasured": ("a.json copy.json --limit-percent 9", 2, "of a.json and copy.json are"),
        "no positions": ("a.json --rig bare.toml", 2, "no led_positions_mm"),
        "photos": ("photos.json --rig rig.toml", 4, "light p0.jpg is not one of"),
        "no rig file": ("a.json --rig none.toml", 2, "none.toml"),
    },
)
def test_refused_in_one_line(
    sgp: Callable[..., object],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: str,
    code: int,
    expected: str,
) -> None:
    monkeypatch.chdir(folder)
    assert expected in sgp("calibrate", "check", *words.split()).error_line(code)


def test_json(sgp: Callable[..., object], folder: Path) -> None:
    answer = sgp(
        "calibrate", "check", folder / "a.json", folder / "moved.json", "--limit-mm", 1, "--json"
    )
    assert answer.code == 4
    result = json.loads(answer.out)
    assert result["ok"] is False
    metrics = result["metrics"]
    assert metrics["lights"] == 12
    assert metrics["beyond"] == 1
    worst = metrics["differences"][0]
    assert worst["id"] == "L05"
    assert worst["beyond"] is True
    assert worst["distance_mm"] == pytest.approx(5)
    assert worst["deviations"] == pytest.approx(5 / np.sqrt(0.08))
    assert "motion" not in metrics
    assert [notice["code"] for notice in result["notices"]] == ["lights-changed"]
