"""The mesh-based peers: what they must do on surfaces where the answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from sgp._paper.displacement import transfer_by_displacement
from sgp._paper.laplacian import transfer_by_laplacian
from sgp._paper.mesh import base, umbrella, vertex_normals

PEERS = [
    pytest.param(transfer_by_displacement, id="DSPL"),
    pytest.param(transfer_by_laplacian, id="LAPL"),
]
SIDE = 60


def grid(side: int = SIDE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, y and faces of a square of unit steps, y up, faces turning toward +z."""
    y, x = np.mgrid[side - 1 : -1 : -1, 0:side].astype(np.float64)
    number = np.arange(side * side, dtype=np.int32).reshape(side, side)
    a, b, d, e = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate(
        [np.stack([a, d, b], axis=-1).reshape(-1, 3), np.stack([b, d, e], axis=-1).reshape(-1, 3)]
    )
    return x.ravel(), y.ravel(), faces


def surface(height: np.ndarray) -> np.ndarray:
    x, y, _ = grid()
    return np.stack([x, y, height], axis=1)


def waves() -> np.ndarray:
    x, y, _ = grid()
    return 0.6 * np.sin(2 * np.pi * x / 6) * np.cos(2 * np.pi * y / 6)


def inner(margin: int = 20) -> np.ndarray:
    x, y, _ = grid()
    return (np.minimum(x, y) >= margin) & (np.maximum(x, y) < SIDE - margin)


def test_umbrella_takes_the_mean_of_the_neighbours():
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    mean = umbrella(faces, 5)
    values = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    np.testing.assert_allclose(mean @ values, [14 / 3, 2.5, 11 / 3, 2.5, 16.0])


def test_a_base_is_as_smooth_as_the_papers_shape():
    x, y, faces = grid()
    impulse = ((x == 30) & (y == 30)).astype(np.float64)[:, None]
    spread = base(umbrella(faces, SIDE**2), impulse, 5)[:, 0]
    assert spread.sum() == pytest.approx(1)
    for along in (x, y):
        assert np.sqrt(spread @ (along - 30) ** 2) == pytest.approx(2.5, rel=0.06)


def test_normals_of_a_tilted_plane_are_exact():
    x, y, faces = grid()
    normals = vertex_normals(surface(0.5 * x - 0.2 * y), faces)
    np.testing.assert_allclose(normals, np.tile([-0.5, 0.2, 1] / np.sqrt(1.29), (SIDE**2, 1)))


@pytest.mark.parametrize("transfer", PEERS)
def test_a_detail_put_onto_a_plane_is_found_there(transfer):
    _, _, faces = grid()
    moved = transfer(surface(waves()), surface(np.zeros(SIDE**2)), faces)
    error = (moved[:, 2] - waves())[inner()]
    assert np.sqrt(np.mean(error**2)) < 0.15 * waves().std()
    np.testing.assert_allclose(moved[inner(), :2], surface(waves())[inner(), :2], atol=0.05)


@pytest.mark.parametrize("transfer", PEERS)
def test_a_detail_turns_with_the_surface_it_is_put_onto(transfer):
    x, _, faces = grid()
    slope = np.tan(np.radians(40))
    moved = transfer(surface(waves()), surface(slope * x), faces)
    along = np.array([-np.sin(np.radians(40)), 0, np.cos(np.radians(40))])
    heights = (moved - surface(slope * x)) @ along
    across = np.linalg.norm(moved - surface(slope * x) - heights[:, None] * along, axis=1)
    assert np.corrcoef(heights[inner()], waves()[inner()])[0, 1] > 0.99
    assert across[inner()].max() < 0.05


@pytest.mark.parametrize("transfer", PEERS)
def test_a_region_receives_and_the_rest_stays(transfer):
    x, y, faces = grid()
    target = surface(0.01 * (x - 30) ** 2)
    region = (x - 30) ** 2 + (y - 30) ** 2 < 18**2
    moved = transfer(surface(waves()), target, faces, region)
    np.testing.assert_array_equal(moved[~region], target[~region])
    deep = (x - 30) ** 2 + (y - 30) ** 2 < 8**2
    # The cut waves at the rim bend the surface inside a little; its detail stays.
    detail = moved - base(umbrella(faces, SIDE**2), moved, 5)
    assert np.corrcoef(detail[deep, 2], waves()[deep])[0, 1] > 0.98


@pytest.mark.parametrize("transfer", PEERS)
def test_a_surface_without_detail_takes_the_targets_away(transfer):
    _, _, faces = grid()
    moved = transfer(surface(np.zeros(SIDE**2)), surface(waves()), faces)
    assert np.abs(moved[inner(), 2]).max() < 0.1 * waves().max()
