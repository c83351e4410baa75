"""Filled holes: shapes that are known, steps at rims, character of the detail, bad input."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquisition import DataError, angle_deg
from processing import NormalMap, fill_holes, read_normals, separate
from rig.arrays import Bool
from tests.processing.scenes import ball
from tests.quick_sample import quick
from tests.real_data import DATA, needs_data


def disc(size: tuple[int, int], x: float, y: float, radius: float) -> Bool:
    rows, columns = np.indices(size)
    return (columns - x) ** 2 + (rows - y) ** 2 <= radius**2


@pytest.fixture(scope="module")
def rough() -> NormalMap:
    """Return a relief on a ball."""
    noise = np.random.default_rng(3).normal(size=(120, 120))
    dy, dx = np.gradient(cv2.GaussianBlur(noise, (0, 0), 1.2))
    bumps = np.stack([-2 * dx, 2 * dy, np.zeros((120, 120))], axis=2)
    return NormalMap.from_vectors(ball().normals + bumps, ball().mask)


HOLES = {
    "inside": disc((120, 120), 60, 60, 15),
    "two": disc((120, 120), 40, 60, 8) | disc((120, 120), 90, 60, 8),
    "at the rim": disc((120, 120), 15, 50, 12) & ball().mask,
    "a pixel": disc((120, 120), 60, 60, 0),
    "speckle": (np.random.default_rng(1).random((120, 120)) < 0.05) & ball().mask,
}


@pytest.mark.parametrize("name", quick(list(HOLES), every=5))
def test_only_holes_change_and_the_detail_stays_as_steep(rough: NormalMap, name: str) -> None:
    holes = HOLES[name]
    filled = fill_holes(rough, holes, patch=12, seed=2)
    np.testing.assert_array_equal(filled.normal_map.normals[~holes], rough.normals[~holes])
    np.testing.assert_array_equal(filled.normal_map.mask, rough.mask | holes)
    np.testing.assert_allclose(
        np.linalg.norm(filled.normal_map.normals[holes], axis=1), 1, atol=1e-6
    )
    assert not (filled.surroundings & holes).any()
    again = fill_holes(rough, holes, patch=12, seed=2)
    np.testing.assert_array_equal(again.normal_map.normals, filled.normal_map.normals)
    # Single pixels continue their neighbours.
    if name not in ("a pixel", "speckle"):
        assert filled.detail_angle_deg == pytest.approx(filled.surroundings_angle_deg, rel=0.15)


@pytest.mark.parametrize("name", quick(["inside", "two", "at the rim"], every=3))
def test_no_step_at_the_rim(rough: NormalMap, name: str) -> None:
    filled = fill_holes(rough, HOLES[name], patch=12)
    assert filled.seam.ratio <= 1.2
    # Cut out and filled with the shape alone, the same hole has a step.
    flat = fill_holes(rough, HOLES[name], patch=12).shape.normals
    bare = NormalMap(
        np.where(HOLES[name][..., None], flat, rough.normals), rough.mask | HOLES[name]
    )
    assert angle_deg(bare.normals, filled.normal_map.normals)[HOLES[name]].mean() > 2


@pytest.mark.parametrize(
    ("name", "most_deg"), quick([("inside", 0.05), ("two", 0.05), ("at the rim", 10)], every=2)
)
def test_the_shape_of_a_ball_is_continued(name: str, most_deg: float) -> None:
    """n_x and n_y of a sphere are linear; a free border at the rim of the object is not exact."""
    filled = fill_holes(ball(), HOLES[name], patch=12)
    off = angle_deg(filled.shape.normals, separate(ball()).shape.normals)
    assert off[HOLES[name]].max() < most_deg


def test_missing_parts_join_the_object(rough: NormalMap) -> None:
    """A missing part has no normals: it is filled all the same, and as it would be if it had."""
    holes = HOLES["inside"]
    missing = NormalMap(np.where(holes[..., None], 0, rough.normals), rough.mask & ~holes)
    np.testing.assert_array_equal(
        fill_holes(missing, holes, patch=12).normal_map.normals,
        fill_holes(rough, holes, patch=12).normal_map.normals,
    )


@pytest.mark.parametrize(
    ("holes", "options", "message"),
    [
        pytest.param(np.zeros((9, 9), bool), {}, r"120\), not bool of", id="size"),
        pytest.param(np.zeros((120, 120)), {}, "not float64 of", id="type"),
        pytest.param(np.zeros((120, 120), bool), {}, "is empty", id="empty"),
        pytest.param(np.ones((120, 120), bool), {}, "covers every normal", id="all"),
        pytest.param(disc((120, 120), 60, 60, 40), {}, "more than the", id="too large"),
        pytest.param(disc((120, 120), 3, 3, 2), {}, "row 1 touches no normal", id="outside"),
        pytest.param(HOLES["inside"], {"patch": 5}, "5 x 5 pixels is too small", id="patch"),
        pytest.param(HOLES["inside"], {"patch": 90}, "no patch of 90 x 90", id="large patch"),
        pytest.param(HOLES["inside"], {"overlap": 6}, "overlap by 2 to 4", id="overlap"),
        pytest.param(HOLES["inside"], {"seed": -1}, "seed of -1", id="seed"),
    ],
)
def test_bad_input(rough: NormalMap, holes: Bool, options: dict[str, int], message: str) -> None:
    with pytest.raises(DataError, match=message):
        fill_holes(rough, holes, **options)  # type: ignore[arg-type]


@pytest.mark.slow
@needs_data
def test_holes_in_a_real_surface() -> None:
    plant = read_normals(DATA / "normals/plant").normal_map
    window = slice(400, 800), slice(400, 800)
    part = NormalMap(plant.normals[window], plant.mask[window])
    filled = fill_holes(part, disc((400, 400), 200, 200, 30) & part.mask)
    assert filled.seam.ratio <= 1.2
    assert filled.detail_angle_deg == pytest.approx(filled.surroundings_angle_deg, rel=0.15)
