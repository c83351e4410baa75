from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from acquisition import angle_deg
from processing.detail.rotation import rotate_between, rotate_from_z, rotate_to_z
from rig.arrays import Float32

ROUND_TRIP_DEG = 5e-5


def unit(vectors: npt.ArrayLike) -> Float32:
    v = np.atleast_2d(np.asarray(vectors, np.float64))
    return (v / np.linalg.norm(v, axis=-1, keepdims=True)).astype(np.float32)[None]


def random_unit(rng: np.random.Generator, count: int) -> Float32:
    return unit(rng.normal(size=(count, 3)))


# Distances from the lower pole on all scales of float32, and arbitrary other distances.
tilts = st.one_of(
    st.floats(0, np.pi),
    st.floats(-44, 0).map(lambda e: np.pi - 10.0**e),
    st.just(np.pi),
    st.just(0.0),
)


@settings(max_examples=200)
@given(tilts, st.floats(0, 2 * np.pi), st.integers(0, 2**32 - 1))
def test_round_trip_is_exact_for_every_pole(tilt: float, azimuth: float, seed: int) -> None:
    # Compute sin(pi - d) from d: float64 pi is not exactly pi, which would limit d to 1e-16.
    sine = np.sin(tilt) if tilt < 3 else np.sin(np.pi - tilt)
    pole = np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(tilt)], np.float32)
    vectors = random_unit(np.random.default_rng(seed), 50)
    poles = np.broadcast_to(pole, vectors.shape).copy()
    there = rotate_to_z(vectors, poles)
    back = rotate_from_z(there, poles)
    assert angle_deg(back, vectors).max() <= ROUND_TRIP_DEG
    back = rotate_to_z(rotate_from_z(vectors, poles), poles)
    assert angle_deg(back, vectors).max() <= ROUND_TRIP_DEG


@pytest.mark.parametrize("distance", [0.0, 1e-45, 1e-30, 1e-15, 1e-8, 1e-6, 1e-4, 3e-4, 1e-2])
def test_round_trip_next_to_the_lower_pole(distance: float) -> None:
    vectors = random_unit(np.random.default_rng(1), 500)
    direction = np.random.default_rng(2).normal(size=(1, 500, 2))
    direction /= np.linalg.norm(direction, axis=2, keepdims=True)
    poles = np.zeros_like(vectors)
    poles[..., :2] = distance * direction
    poles[..., 2] = -np.sqrt(1 - distance**2)
    back = rotate_from_z(rotate_to_z(vectors, poles), poles)
    assert angle_deg(back, vectors).max() <= ROUND_TRIP_DEG
    assert angle_deg(rotate_to_z(poles, poles), (0, 0, 1)).max() <= ROUND_TRIP_DEG


def test_it_is_the_shortest_arc() -> None:
    rng = np.random.default_rng(3)
    vectors, poles = random_unit(rng, 300), random_unit(rng, 300)
    p = poles[0].astype(np.float64)
    axis = np.cross(p, (0, 0, 1))
    angle = np.arctan2(np.linalg.norm(axis, axis=1), p[:, 2])
    turn = Rotation.from_rotvec(axis / np.linalg.norm(axis, axis=1)[:, None] * angle[:, None])
    expected = turn.apply(vectors[0])
    np.testing.assert_allclose(rotate_to_z(vectors, poles)[0], expected, atol=3e-7)
    expected = turn.inv().apply(vectors[0])
    np.testing.assert_allclose(rotate_from_z(vectors, poles)[0], expected, atol=3e-7)


def test_the_lower_pole_is_rotated_about_x() -> None:
    vectors = unit([[1, 2, 3], [0, 0, -1]])
    poles = unit([[0, 0, -1], [0, 0, -1]])
    np.testing.assert_array_equal(rotate_to_z(vectors, poles), vectors * [1, -1, -1])


def test_a_zero_pole_gives_zero() -> None:
    vectors = unit([[1, 2, 3], [3, 2, 1]])
    poles = unit([[0, 0.6, 0.8], [0, 0, 1]])
    poles[0, 0] = 0
    for rotate in (rotate_to_z, rotate_from_z):
        out = rotate(vectors, poles)
        np.testing.assert_array_equal(out[0, 0], 0)
        np.testing.assert_array_equal(out[0, 1], vectors[0, 1])


def test_rotation_between_is_the_shortest_arc() -> None:
    rng = np.random.default_rng(4)
    vectors, starts, ends = (random_unit(rng, 300) for _ in range(3))
    a, b = starts[0].astype(np.float64), ends[0].astype(np.float64)
    axis = np.cross(a, b)
    sine = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", a, b))
    turn = Rotation.from_rotvec(axis / sine[:, None] * angle[:, None])
    out = rotate_between(vectors, starts, ends)
    np.testing.assert_allclose(out[0], turn.apply(vectors[0]), atol=4e-7)
    assert angle_deg(rotate_between(starts, starts, ends), ends).max() < ROUND_TRIP_DEG
    # The zero rotation is exact up to rounding.
    np.testing.assert_allclose(rotate_between(vectors, starts, starts), vectors, atol=2e-7)


@pytest.mark.parametrize("gap", [0.0, 1e-15, 1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_rotation_between_opposite_vectors(gap: float, axis: int) -> None:
    start = np.roll([1.0, 0.0, 0.0], axis)
    end = -start + gap * np.roll([0.0, 0.6, 0.8], axis)
    vectors = random_unit(np.random.default_rng(5), 100)
    starts = np.broadcast_to(unit(start), vectors.shape).copy()
    ends = np.broadcast_to(unit(end), vectors.shape).copy()
    assert angle_deg(rotate_between(starts, starts, ends), ends).max() < ROUND_TRIP_DEG
    turned = rotate_between(vectors, starts, ends)
    # A rotation keeps angles between vectors.
    before = angle_deg(vectors[:, :-1], vectors[:, 1:])
    np.testing.assert_allclose(angle_deg(turned[:, :-1], turned[:, 1:]), before, atol=1e-4)
