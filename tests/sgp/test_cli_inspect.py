"""``sgp inspect``, and the same lines and figures of ``sgp normals`` and ``sgp run``."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from acquisition import Lights, write_lights, write_png
from processing import NormalMap, write_normals
from sgp import read_record

COUNT = 10
SIZE = 64


def lights() -> Lights:
    around = np.arange(COUNT) * 2.4
    out = np.sqrt((np.arange(COUNT) + 0.5) / COUNT)
    return Lights(
        directions=np.stack([out * np.cos(around), out * np.sin(around), 0.9 + 0 * out], 1)
    )


def bumps() -> tuple[np.ndarray, np.ndarray]:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    x, y = (columns - 31.5) / 28, (31.5 - rows) / 28
    p, q = 0.5 * np.cos(3 * x) * np.cos(2 * y + 1), -np.sin(3 * x) * np.sin(2 * y + 1) / 3
    normals = np.dstack([-p, -q, np.ones_like(p)])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True), x**2 + y**2 < 1


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Ten images of a bumpy disc, with lights.json and shuffled.json next to their folder."""
    path = tmp_path / "bumps"
    path.mkdir()
    write_lights(tmp_path / "lights.json", lights())
    order = np.random.default_rng(2).permutation(COUNT)
    write_lights(tmp_path / "shuffled.json", Lights(directions=lights().unit_directions[order]))
    normals, mask = bumps()
    for i, light in enumerate(lights().unit_directions):
        shade = np.where(mask, 0.7 * np.clip(normals @ light, 0, 1), 0)
        write_png(path / f"{i:02d}.png", np.rint(shade * 65535).astype(np.uint16))
    return path


def test_a_correct_recording(sgp: Callable, folder: Path) -> None:
    before = sorted(folder.parent.rglob("*"))
    answer = sgp("inspect", folder, "--lights", folder.parent / "lights.json").ok()
    lines = answer.out.splitlines()
    assert lines[0].startswith("10 images, distant lights, ")
    assert lines[-1] == "good: nothing was found that changes the normals by more than 1 deg"
    for start in ("residual ", "lights differ ", "brightness ", "curl "):
        assert sum(line.startswith(start) for line in lines) == 1
    assert max(map(len, lines)) <= 78
    assert sorted(folder.parent.rglob("*")) == before


def test_too_little_data_is_not_called_agreement(sgp: Callable, folder: Path) -> None:
    # Too few images for any test, and too few pixels for the curl.
    part = ("--exclude", "0-5", "--downscale", "4")
    answer = sgp("inspect", folder, "--lights", folder.parent / "lights.json", *part).ok()
    assert answer.out.splitlines()[-1].startswith("good: but too little data: ")


def test_shuffled_lights_are_named_and_the_exit_code_stays(sgp: Callable, folder: Path) -> None:
    printed = sgp("inspect", folder, "--lights", folder.parent / "shuffled.json", "--json").report()
    assert printed["ok"]
    assert printed["outputs"] == {}
    assert "lights-shuffled" in [notice["code"] for notice in printed["notices"]]
    assert printed["metrics"]["residual_relative"] > 0.1
    shown = sgp("inspect", folder, "--lights", folder.parent / "shuffled.json")
    assert "in another order than the images" in shown.err
    last = shown.out.splitlines()[-1]
    assert last.startswith("do not use: the images fit each other to ")
    assert "(normals change by " in last


def test_strict_fails_on_a_result_that_must_not_be_used(sgp: Callable, folder: Path) -> None:
    right, wrong = (folder.parent / f"{name}.json" for name in ("lights", "shuffled"))
    assert sgp("inspect", folder, "--lights", right, "--strict").code == 0
    assert sgp("inspect", folder, "--lights", wrong, "--strict").code == 6
    out = folder.parent / "out"
    answer = sgp("normals", folder, "--lights", wrong, "--out", out, "--strict", "--json")
    assert answer.code == 6
    printed, record = json.loads(answer.out), read_record(out / "normals.json")
    assert not printed["ok"]
    assert printed["verdict"] == record.verdict == "do-not-use"
    (cause,) = printed["causes"]
    assert [cause] == [one.model_dump(mode="json") for one in record.causes]
    assert cause["name"] == "lights-shuffled"
    assert cause["normals_deg"] > 15
    assert cause["height_mm"] is None
    assert cause["remedy"] == "check the order of images and lights"
    assert (out / "normals.exr").exists()


@pytest.mark.parametrize("command", ["normals", pytest.param("run", marks=pytest.mark.slow)])
def test_the_commands_that_write_show_the_same(sgp: Callable, folder: Path, command: str) -> None:
    words = ("--lights", folder.parent / "lights.json")
    inspected = sgp("inspect", folder, *words).out.splitlines()
    out = folder.parent / "out"
    answer = sgp(command, folder, *words, "--out", out).ok()
    for line in inspected[1:-1]:
        assert line in answer.out
    figures = read_record(
        out / ("normals.json" if command == "normals" else "summary.json")
    ).metrics
    figures = figures if command == "normals" else figures["normals"]
    printed = json.loads(sgp("inspect", folder, *words, "--json").out)["metrics"]
    assert {key: figures[key] for key in printed} == printed
    assert len(figures["light_errors_deg"]) == COUNT


@pytest.mark.parametrize("option", ["--method=ls", "--out=x", "--force"])
def test_it_accepts_no_option_without_effect(sgp: Callable, folder: Path, option: str) -> None:
    assert option.split("=")[0] in sgp("inspect", folder, option).error_line(2)


def test_a_source_without_lights_is_refused(sgp: Callable, folder: Path) -> None:
    line = sgp("inspect", folder).error_line(4)
    assert re.search(r"no lights: .*--lights\), .*--spheres\)", line)


def test_a_surface_of_mirrored_normals_is_reported(sgp: Callable, tmp_path: Path) -> None:
    normals, mask = bumps()
    write_normals(tmp_path / "n", NormalMap.from_vectors(normals, mask))
    png = tmp_path / "n" / "normals.png"
    assert "surface" not in sgp("surface", png, "--out", tmp_path / "right").err
    wrong = sgp("surface", png, "--green", "down", "--out", tmp_path / "wrong").ok()
    assert "not those of a surface" in wrong.err
    metrics = read_record(tmp_path / "wrong" / "surface.json").metrics
    assert metrics["disagreement_deg"] > 1
