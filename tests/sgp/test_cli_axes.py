"""Every command that reads a normal map names one whose green channel is inverted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from acquisition import write_mask
from processing import NormalMap, write_normals

SIDE = 72


@pytest.fixture(scope="module")
def maps(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a relief, the same with green down, with red as blue, and a mask."""
    folder = tmp_path_factory.mktemp("axes")
    waves = gaussian_filter(np.random.default_rng(3).normal(size=(SIDE, SIDE)), 2)
    down, right = np.gradient(1.2 * waves / waves.std())
    up = NormalMap.from_vectors(np.dstack([-right, down, np.ones_like(right)]))
    write_normals(folder / "up", up)
    write_normals(folder / "down", NormalMap(up.normals * np.float32([1, -1, 1]), up.mask))
    np.save(folder / "bgr.npy", up.normals[..., ::-1])
    hole = np.zeros((SIDE, SIDE), np.bool_)
    hole[30:40, 30:40] = True
    write_mask(folder / "hole.png", hole)
    return folder


# The words before the map that is tried, those after it, and the option that is named.
COMMANDS = {
    "separate": ("detail separate", "", "--green down"),
    "combine": ("detail combine up", "", None),
    "fill": ("detail fill", "--holes hole.png", "--green down"),
    "superres": ("detail superres", "--scale 2 --method bicubic", "--green down"),
    "transfer, source": ("detail transfer", "up", "--source-green down"),
    "transfer, target": ("detail transfer up", "", "--target-green down"),
    "sheet": ("detail synthesize", "--size 64x64 --patch 16", "--green down"),
    "sheet of detail": ("detail synthesize --is-detail", "--size 64x64 --patch 16", "--green down"),
    "target": ("detail synthesize up --patch 16 --onto", "", "--target-green down"),
    "properties": ("detail properties", "", "--green down"),
    "compare A": ("compare", "up", "--green down"),
    "compare B": ("compare up", "", "--green-b down"),
    "curvature": ("curvature", "", "--green down"),
    "surface": ("surface", "", "--green down"),
}
_QUICK = ("separate", "combine")


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name in _QUICK else [pytest.mark.slow]) for name in COMMANDS],
)
def test_a_map_with_green_down_is_named(
    sgp, maps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(maps)
    before, after, option = COMMANDS[name]
    for given in ("up", "down"):
        words = [*before.split(), given, *after.split(), "--out", tmp_path / given, "--json"]
        found = [
            notice
            for notice in sgp(*words).report()["notices"]
            if notice["code"] == "normals-mirrored"
        ]
        assert len(found) == (given == "down"), (given, found)
    if name != "surface":
        assert Path(found[0]["where"]).name == "down"
    if option is None:
        assert "--" not in found[0]["text"]
    else:
        assert found[0]["text"].endswith(f"if green is the other way round, {option}")


def test_maps_of_both_conventions_are_compared(sgp, maps: Path) -> None:
    words = ("compare", maps / "down", maps / "up", "--green", "down", "--green-b", "up", "--json")
    assert sgp(*words).figures()["mae_deg"] < 1e-3
    assert sgp(*words[:-3], "--json").figures()["mae_deg"] > 10


def test_swapped_channels_are_the_only_cause_that_is_named(
    sgp, maps: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(maps)
    codes = sgp("detail", "separate", "bgr.npy", "--out", tmp_path / "out", "--json").codes()
    assert "normals-channels-swapped" in codes
    assert "normals-mirrored" not in codes
