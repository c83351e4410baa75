"""Axes of normal maps: wrong ones are named at the scale that shows them, right ones are quiet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from processing import NormalMap, read_normals, separate
from processing.surface import axes_notices, integrability
from tests.real_data import DATA, needs_data

SIDE = 160
EVERYWHERE = np.ones((SIDE, SIDE), np.bool_)


def turned(normals: np.ndarray, axes: str) -> np.ndarray:
    """Return the normals with the x and y of other axes."""
    x, y, z = np.moveaxis(normals, 2, 0)
    ways = {
        "right": (x, y),
        "green down": (x, -y),
        "red left": (-x, y),
        "turned": (-y, x),
        "swapped": (y, x),
        "upside down": (-x, -y),
    }
    return np.ascontiguousarray(np.dstack([*ways[axes], z]), np.float32)


NAMED = {
    "right": [],
    "green down": ["mirrored left to right or top to bottom"],
    "red left": ["mirrored left to right or top to bottom"],
    "turned": ["turned by 90 degrees"],
    "swapped": ["x and y swapped"],
    "upside down": [],
}


@pytest.fixture(scope="module")
def reliefs() -> dict[str, np.ndarray]:
    """Return normals of fine, of coarse, and of fine relief without its low frequencies."""
    heights = {}
    for name, sigma in {"fine": 1.5, "coarse": 12.0}.items():
        waves = gaussian_filter(np.random.default_rng(7).normal(size=(SIDE, SIDE)), sigma)
        heights[name] = 0.4 * sigma * waves / waves.std()
    found = {}
    for name, height in heights.items():
        down, right = np.gradient(height)
        normals = np.dstack([-right, down, np.ones_like(height)])
        found[name] = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    detail = separate(NormalMap.from_vectors(found["fine"])).detail
    return {**found, "detail": detail.normals}


def test_wrong_axes_are_named_whatever_the_scale_of_the_relief(reliefs) -> None:
    rng = np.random.default_rng(8)
    noise = np.radians(6) * rng.normal(size=(SIDE, SIDE, 3))
    cases = {name: (normals, EVERYWHERE) for name, normals in reliefs.items()}
    cases["coarse, noisy"] = (reliefs["coarse"] + noise, EVERYWHERE)
    cases["fine, noisy"] = (reliefs["fine"] + noise, EVERYWHERE)
    cases["fine, in parts"] = (reliefs["fine"], gaussian_filter(noise[..., 0], 9) > 0)
    for name, (normals, mask) in cases.items():
        for axes, causes in NAMED.items():
            given = NormalMap.from_vectors(turned(normals, axes), mask)
            texts = [notice.text for notice in axes_notices(given)]
            assert len(texts) == len(causes), (name, axes, texts)
            assert all(cause in text for cause, text in zip(causes, texts, strict=True))


def test_what_shows_no_axes_is_quiet(reliefs) -> None:
    rng = np.random.default_rng(9)
    rows = np.arange(SIDE)[:, None] + np.zeros((1, SIDE))
    stripes = np.where(rows.T % 17 < 9, 0.7, -0.7)  # slopes along y, in stripes along y
    one = np.ones((SIDE, SIDE))
    cases = {
        "plane": np.dstack([0.3 * one, 0.1 * one, one]),
        "noise": np.dstack([*rng.normal(0, 0.1, (2, SIDE, SIDE)), one]),
        "grooves": np.dstack([0 * one, 0.3 * np.sin(rows / 4), one]),
        "steps between slopes": np.dstack([0 * one, stripes, one]),
        "steps, noisy": np.dstack([0 * one, stripes, one]) + rng.normal(0, 0.1, (SIDE, SIDE, 3)),
        "few pixels": reliefs["fine"][:16, :16],
        "a row": reliefs["fine"][:1],
    }
    for name, vectors in cases.items():
        normals = NormalMap.from_vectors(vectors)
        assert axes_notices(normals) == [], name


def test_a_large_map_is_judged_by_the_parts_with_normals(reliefs) -> None:
    normals, mask = np.zeros((1100, 1100, 3), np.float32), np.zeros((1100, 1100), np.bool_)
    place = slice(900, 900 + SIDE)
    normals[place, place], mask[place, place] = turned(reliefs["fine"], "green down"), True
    assert integrability(normals, mask).axes == "mirrored"


@needs_data
@pytest.mark.parametrize(
    "name",
    [
        "diligent/buddha",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in (
                *("owl", "plant", "diligent/bear", "diligent/cat", "diligent/cow"),
                *("diligent/goblet", "reliefs/151.jpg", "reliefs/160.jpg", "reliefs/188.jpg"),
            )
        ),
    ],
)
def test_captured_maps_are_quiet_unless_green_is_inverted(name: str) -> None:
    given = read_normals(DATA / name if "." in name else DATA / "normals" / name).normal_map
    assert axes_notices(given) == []
    down = NormalMap(turned(given.normals, "green down"), given.mask)
    assert [notice.code for notice in axes_notices(down)] == ["normals-mirrored"]
    if name != "plant":  # the narrow leaves of its detail are no surface with any axes
        for one, count in ((given, 0), (down, 1)):
            assert len(axes_notices(separate(one).detail)) == count


@needs_data
@pytest.mark.slow
def test_swapped_channels_of_captured_maps_are_named(tmp_path: Path) -> None:
    files = [*DATA.glob("reliefs/*.jpg"), *DATA.glob("normals/*"), *DATA.glob("normals/d*/*")]
    for file in files:
        if file.name == "diligent":
            continue
        read = read_normals(file)
        assert "normals-channels-swapped" not in [notice.code for notice in read.warnings], file
        for channels in ((2, 1, 0), (0, 2, 1)):
            np.save(tmp_path / "n.npy", read.normal_map.normals[..., channels])
            swapped = read_normals(tmp_path / "n.npy").warnings
            assert "normals-channels-swapped" in [notice.code for notice in swapped], file
    assert len(files) > 10
