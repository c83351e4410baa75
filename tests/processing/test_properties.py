from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from acquisition import DataError
from processing import HeightMap, NormalMap, height_profile, integrate, read_normals, separate, ssim
from processing.detail import cross_exchange, idempotence, rotation_similarity, transfer_chain
from tests.processing.scenes import ball, relief
from tests.real_data import DATA, needs_data

TARGETS = ("bear", "buddha", "cat", "cow", "goblet")


def plane(normal: tuple[float, float, float], size: tuple[int, int] = (60, 60)) -> NormalMap:
    return NormalMap.from_vectors(np.broadcast_to(normal, (*size, 3)))


def to_z(normal: np.ndarray) -> np.ndarray:
    """Return the shortest rotation of a unit vector to z, from its rotation vector."""
    axis = np.cross(normal, (0, 0, 1))
    sine = np.linalg.norm(axis)
    angle = np.arctan2(sine, normal[2])
    return Rotation.from_rotvec(axis / sine * angle if sine else 0 * axis).as_matrix()


@pytest.mark.parametrize("z_sign", [1, -1], ids=["facing", "facing away"])
def test_rotation_similarity_is_the_papers_formula(z_sign: int) -> None:
    rng = np.random.default_rng(0)
    vectors = rng.normal(size=(7, 8, 3))
    vectors[..., 2] = z_sign * np.abs(vectors[..., 2])
    normal_map = NormalMap.from_vectors(vectors, rng.random((7, 8)) < 0.8)
    w = 2
    means = []
    for r, c in np.argwhere(normal_map.mask):
        figures = []
        for q in range(max(r - w, 0), min(r + w + 1, 7)):
            for d in range(max(c - w, 0), min(c + w + 1, 8)):
                if normal_map.mask[q, d]:
                    between = to_z(normal_map.normals[r, c]) @ to_z(normal_map.normals[q, d]).T
                    turn = np.degrees(Rotation.from_matrix(between).magnitude())
                    off = between - np.eye(3)
                    norms = [np.linalg.norm(off, p) for p in (1, 2, np.inf)]
                    figures.append([turn, *norms])
        means.append(np.mean(figures, axis=0))
    similarity = rotation_similarity(normal_map, w)
    np.testing.assert_allclose(
        [similarity.angle_deg, similarity.norm_1, similarity.norm_2, similarity.norm_inf],
        np.mean(means, axis=0),
        rtol=1e-5,
    )


def test_all_rotations_of_a_plane_are_equal_including_the_lower_pole() -> None:
    for normal in ((0.0, 0.6, 0.8), (0.0, 0.0, -1.0), (1e-20, 0.0, -1.0)):
        similarity = rotation_similarity(plane(normal))
        assert similarity.angle_deg < 1e-6
        assert similarity.norm_2 < 1e-6


def test_an_empty_window_is_refused() -> None:
    with pytest.raises(DataError, match="1 or more"):
        rotation_similarity(plane((0, 0, 1)), 0)


def test_the_detail_of_a_plane_is_idempotent_and_that_of_a_relief_nearly() -> None:
    for comparison in idempotence(separate(plane((0.0, 0.6, 0.8)))).values():
        assert comparison.mae_deg < 1e-3
        assert comparison.ssim == pytest.approx(1)
    orders = idempotence(separate(relief(0, (80, 80))), highest=4)
    assert list(orders) == [2, 3, 4]
    errors = [orders[k].mae_deg for k in (2, 3, 4)]
    assert 0.1 < errors[0] < errors[1] < errors[2] < 10
    assert orders[2].ssim > orders[3].ssim > orders[4].ssim


def test_idempotence_starts_at_order_2() -> None:
    with pytest.raises(DataError, match="order 2 or more"):
        idempotence(separate(plane((0, 0, 1))), 1)


def test_a_chain_over_planes_is_equivalent_to_repeated_separation() -> None:
    """On a plane the detail is rotated uniformly: each step is nearly one more order."""
    source = relief(1, (70, 60))
    planes = [plane((0.0, 0.6, 0.8), (60, 70)), plane((0.6, 0.0, 0.8), (90, 90))]
    steps = transfer_chain(source, planes)
    assert [step.target for step in steps] == [0, 1, 0]
    assert {step.pixels for step in steps} == {60 * 60}
    middle = NormalMap(source.normals[5:65], source.mask[5:65])
    orders = idempotence(separate(middle))
    for step, order in zip(steps, (2, 3, 4), strict=True):
        assert step.to_original.mae_deg == pytest.approx(orders[order].mae_deg, abs=1e-2)
    assert steps[0].to_previous == steps[0].to_original
    assert steps[1].to_previous.mae_deg < steps[1].to_original.mae_deg


def test_a_chain_requires_targets_that_fit_the_filter() -> None:
    with pytest.raises(DataError, match="at least one target"):
        transfer_chain(ball(), [])
    with pytest.raises(DataError, match="larger than the normal map of 8 x 8"):
        transfer_chain(ball(), [plane((0, 0, 1), (8, 8))])


def test_an_exchange_puts_each_detail_on_the_other_shape() -> None:
    a, b = ball(), relief(2, (120, 120))
    there, back = cross_exchange(a, b)
    assert there.normal_map.size == b.size
    assert back.normal_map.size == a.size
    assert back.fidelity.detail_mae_deg > there.fidelity.detail_mae_deg > 0


def surface(height: np.ndarray, parts: np.ndarray | None = None) -> HeightMap:
    mask = np.isfinite(height)
    if parts is None:
        parts = np.where(mask, 0, -1)
    maps = {"height": height.astype(np.float32), "parts": parts.astype(np.int32)}
    return HeightMap(maps, mask, "px", 1.0, None, 0, 0.0, ())


def test_a_height_profile_is_sorted_by_the_heights_of_the_target() -> None:
    rng = np.random.default_rng(3)
    target = rng.normal(size=(30, 40))
    target[0, :5] = np.nan
    ripple = np.where(np.indices(target.shape).sum(axis=0) % 2, 1.0, -1.0)
    profile = height_profile(surface(target), surface(target + ripple + 7))
    assert (np.diff(profile.target) >= 0).all()
    assert profile.rms == pytest.approx(1, abs=0.01)
    assert len(profile.target) == 30 * 40 - 5
    same = height_profile(surface(target), surface(target - 3))
    np.testing.assert_allclose(same.result, same.target, atol=1e-5)


def test_the_profile_is_smoothed_over_5_by_5_pixels_of_the_mask() -> None:
    flat = np.zeros((21, 21))
    spike = flat.copy()
    spike[10, 10] = 25 * 441 / 440
    spike[0, 0] = np.nan
    profile = height_profile(surface(flat), surface(spike))
    # The mean over the surface is subtracted first; sorting is stable, so pixels keep their order.
    mean = 25 * 441 / 440 / 440
    smoothed = profile.smoothed + mean
    assert np.count_nonzero(smoothed > 0.5) == 25
    assert smoothed.max() == pytest.approx(441 / 440, rel=1e-4)


def test_separate_parts_are_levelled_separately() -> None:
    height = np.tile(np.arange(20.0), (10, 1))
    parts = np.zeros((10, 20))
    parts[:, 10:] = 1
    moved = height + np.where(parts, 30.0, -4.0)
    profile = height_profile(surface(height), surface(moved, parts))
    assert profile.rms < 1e-5


@pytest.mark.parametrize(
    ("result", "text"),
    [
        pytest.param(np.zeros((3, 4)), "different size", id="size"),
        pytest.param(np.where(np.eye(5) > 0, 0.0, np.nan), "do not overlap", id="masks"),
    ],
)
def test_profiles_refuse(result: np.ndarray, text: str) -> None:
    target = np.where(np.eye(5) > 0, np.nan, 0.0)
    with pytest.raises(DataError, match=text):
        height_profile(surface(target), surface(result))


def test_the_surface_of_a_detail_is_flat_compared_with_that_of_its_map() -> None:
    normal_map = ball()
    detail = separate(normal_map).detail
    whole, flat = integrate(normal_map).height, integrate(detail).height
    assert np.ptp(flat[normal_map.mask]) < 0.1 * np.ptp(whole[normal_map.mask])
    assert ssim(detail, normal_map) < 0.9


@needs_data
@pytest.mark.parametrize(
    ("source", "separability", "mae", "ssim_paper"),
    [pytest.param("owl", 0.75, 2.1, 0.996, id="owl"), pytest.param("plant", 2, 4.5, 0.99, id="p")],
)
def test_a_real_detail_survives_a_chain(
    source: str, separability: float, mae: float, ssim_paper: float
) -> None:
    folder = DATA / "normals"
    normal_map = read_normals(folder / source).normal_map
    targets = [read_normals(folder / "diligent" / name).normal_map for name in TARGETS]
    assert separate(normal_map).separability_deg < separability
    steps = transfer_chain(normal_map, targets)
    assert max(step.to_original.mae_deg for step in steps) < mae
    assert min(step.to_original.ssim_paper for step in steps) > ssim_paper
    assert max(step.shape_mae_deg for step in steps) < mae
