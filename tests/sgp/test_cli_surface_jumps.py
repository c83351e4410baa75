"""`sgp surface --discontinuity`: files, figures and messages."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

from acquisition import read_image
from processing import NormalMap, write_normals
from tests.processing.test_jumps import horn


def test_jumps_are_written_and_reported(sgp, tmp_path) -> None:
    write_normals(tmp_path / "n", horn()[0])
    options = ["--pixel-mm", "0.5", "--close"]
    found = {}
    for name, more in (("plain", ["--smooth"]), ("jumps", ["--k", "3"])):
        answer = sgp("surface", tmp_path / "n", *options, *more, "--out", tmp_path / name)
        assert answer.code == 0, answer.err
        assert "normals of the surface differ from the given ones by" in answer.out + answer.err
        stored = json.loads((tmp_path / name / "surface.json").read_text(encoding="utf-8"))
        found[name] = stored["metrics"]
        residual = read_image(tmp_path / name / "normal_residual_deg.exr")
        mean = np.nanmean(residual)
        assert np.isclose(found[name]["normal_residual_deg"], mean, rtol=1e-4)
        assert trimesh.load(tmp_path / name / "solid.stl").is_watertight
        maps = {path.stem for path in (tmp_path / name).glob("*.png")}
        assert ({"discontinuity", "parts"} <= maps) == (name == "jumps")
    assert found["jumps"]["normal_residual_deg"] < 0.25 * found["plain"]["normal_residual_deg"]
    assert found["jumps"]["jumps"] > 50
    assert isinstance(found["jumps"]["settled"], bool)
    assert "settled" not in found["plain"]


@pytest.mark.parametrize(
    ("options", "reason"),
    [("--smooth --discontinuity", "exclude each other"), ("--smooth --k 3", "leave it out")],
    ids=["both", "k of a smooth surface"],
)
def test_options_that_exclude_each_other(sgp, tmp_path, options, reason) -> None:
    write_normals(tmp_path / "n", horn(20)[0])
    line = sgp("surface", tmp_path / "n", *options.split(), "--out", tmp_path / "o").error_line(2)
    assert reason in line


def test_mirrored_green_names_the_option(sgp, tmp_path) -> None:
    y, x = np.mgrid[1:-1:60j, -1:1:60j]
    waves = np.cos(2 * x + 3 * y)
    saddle = NormalMap.from_vectors(np.dstack([y + waves, x + 1.5 * waves, 0 * x + 2]))
    write_normals(tmp_path / "n", saddle, green="down")
    png = tmp_path / "n" / "normals.png"
    wrong = sgp("surface", png, "--out", tmp_path / "wrong")
    right = sgp("surface", png, "--green", "down", "--out", tmp_path / "right")
    assert (wrong.code, right.code) == (0, 0), wrong.err + right.err
    assert "--green down" in wrong.err
    assert "--green" not in right.err
