"""Integration with deviations of normals and with known heights, and errors of heights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from acquisition import CameraModel, DataError
from processing import HeightMap, HeightPrior, NormalMap, integrate
from rig.arrays import Bool, Float32, Float64


@dataclass(frozen=True, eq=False)
class Waves:
    """A wavy surface on a disc, and its normals."""

    height: Float64
    vectors: Float64
    mask: Bool

    def noisy(self, sigma_deg: Float32, seed: int) -> NormalMap:
        noise = np.random.default_rng(seed).normal(size=self.vectors.shape)
        turned = self.vectors + np.radians(sigma_deg)[..., None] / np.sqrt(2) * noise
        return NormalMap.from_vectors(turned, self.mask)


def waves(size: int) -> Waves:
    y, x = np.mgrid[:size, :size].astype(np.float64)
    height = 8 * np.sin(x / 20) * np.cos(y / 15)
    across = 8 / 20 * np.cos(x / 20) * np.cos(y / 15)
    down = -8 / 15 * np.sin(x / 20) * np.sin(y / 15)
    vectors = np.dstack([-across, down, np.ones_like(x)])
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    middle = (size - 1) / 2
    return Waves(height, vectors, np.hypot(x - middle, y - middle) < 0.49 * size)


def flat(rows: int, columns: int) -> NormalMap:
    return NormalMap.from_vectors(np.tile([0.0, 0.0, 1.0], (rows, columns, 1)))


def rms(surface: HeightMap, truth: Float64, where: Bool) -> float:
    error = (surface.height - truth)[where & surface.mask]
    return float(np.std(error))


@pytest.mark.parametrize("discontinuity", [False, True])
def test_a_noisy_region_does_not_spoil_the_rest(discontinuity: bool) -> None:
    scene = waves(96)
    sigma = np.full(scene.mask.shape, 1.0, np.float32)
    sigma[30:60, 40:75] = 10
    good = sigma == 1
    errors = []
    for seed in range(3):
        normals = scene.noisy(sigma, seed)
        plain = integrate(normals, discontinuity=discontinuity)
        weighted = integrate(normals, sigma_deg=sigma, discontinuity=discontinuity)
        unused = integrate(normals, sigma_deg=sigma, weighted=False, discontinuity=discontinuity)
        np.testing.assert_array_equal(unused.height, plain.height)
        errors.append([rms(plain, scene.height, good), rms(weighted, scene.height, good)])
    plain_rms, weighted_rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert weighted_rms < 0.5 * plain_rms
    # A deviation that is not known is as large as the largest.
    sigma[30:40, 40:75] = np.nan
    again = integrate(normals, sigma_deg=sigma, discontinuity=discontinuity)
    np.testing.assert_array_equal(again.height, weighted.height)


def test_equal_deviations_change_nothing() -> None:
    scene = waves(40)
    normals = scene.noisy(np.full((40, 40), 2, np.float32), 1)
    for sigma in (np.full((40, 40), 3, np.float32), np.full((40, 40), np.nan, np.float32)):
        found = integrate(normals, sigma_deg=sigma)
        np.testing.assert_allclose(found.height, integrate(normals).height, atol=1e-6)


def test_heights_of_a_rim_give_the_harmonic_function() -> None:
    y, x = np.mgrid[-12:13, -16:17].astype(np.float32)
    harmonic = 0.01 * (x**2 - y**2 + x * y)  # also of the five-point Laplacian
    rim = harmonic.copy()
    rim[1:-1, 1:-1] = np.nan
    sigma = np.where(np.isnan(rim), np.nan, np.float32(1e-4))
    surface = integrate(flat(25, 33), pixel_mm=0.5, prior=HeightPrior(rim, sigma))
    assert surface.unit == "mm"
    np.testing.assert_allclose(surface.height, harmonic, atol=2e-4)


def test_points_in_perspective_fix_the_distance() -> None:
    camera = CameraModel(np.array([[300.0, 0, 40], [0, 300.0, 30], [0, 0, 1]]), 80, 60, 400.0)
    points = HeightPrior.from_points([[10, 8], [70, 50]], [25, 25], 0.01, (60, 80))
    surface = integrate(flat(60, 80), camera=camera, prior=points)
    np.testing.assert_allclose(surface.height, 25, atol=1e-3)
    assert surface.depth is not None
    np.testing.assert_allclose(surface.depth, 375, atol=1e-3)


def test_a_coarse_map_removes_a_bend_and_keeps_the_detail() -> None:
    scene = waves(96)
    x = np.mgrid[:96, :96][1] - 47.5
    bent = scene.vectors / scene.vectors[..., 2:] - np.dstack([0.002 * x, 0 * x, 0 * x])
    normals = NormalMap.from_vectors(bent, scene.mask)
    blocks = scene.height.reshape(12, 8, 12, 8).mean(axis=(1, 3))
    rng = np.random.default_rng(3)
    coarse = blocks + rng.normal(size=blocks.shape) * 0.2
    coarse[:3, :4] = np.nan
    # Smaller than the errors of its heights: those of the normals are alike, which it removes.
    prior = HeightPrior.from_map(coarse, 0.01, (96, 96))
    inside = scene.mask
    free, held = integrate(normals), integrate(normals, prior=prior)
    assert rms(held, scene.height, inside) < 0.4 * rms(free, scene.height, inside)
    assert abs((held.height - scene.height)[inside].mean()) < 0.1
    slopes = np.diff(held.height - scene.height, axis=0)[inside[1:] & inside[:-1]]
    assert np.std(slopes) < 0.03  # the map alone: .2


def test_maps_are_placed_at_the_centres_of_their_pixels() -> None:
    y, x = np.mgrid[:12, :16].astype(np.float64)
    plane = 0.3 * x - 0.2 * y
    coarse = plane.reshape(3, 4, 4, 4).mean(axis=(1, 3))
    prior = HeightPrior.from_map(coarse, 0.5, (12, 16))
    assert np.nanmax(np.abs(prior.height - plane)) < 1e-6
    # Half a coarse pixel at the rim is not known.
    assert prior.count == 8 * 12
    np.testing.assert_allclose(np.nanmin(prior.sigma), 2.0)
    assert HeightPrior.from_map(plane, 0.5, (12, 16)).count == plane.size


def test_a_prior_joins_parts() -> None:
    normals = flat(20, 31)
    mask = normals.mask.copy()
    mask[:, 15] = False
    apart = NormalMap.from_vectors(normals.normals, mask)
    places, heights = [[3, 3], [25, 9], [15, 3], [40, 2]], [1.0, 5.0, 9.0, 9.0]
    both = integrate(apart, prior=HeightPrior.from_points(places, heights, 0.01, (20, 31)))
    assert [notice.code for notice in both.warnings] == ["prior-outside"]
    assert "2 heights of the prior, of 4, are outside" in both.warnings[0].text
    np.testing.assert_allclose(both.height[:, :15], 1, atol=1e-4)
    np.testing.assert_allclose(both.height[:, 16:], 5, atol=1e-4)
    one = integrate(apart, prior=HeightPrior.from_points(places[:1], heights[:1], 0.01, (20, 31)))
    assert [notice.code for notice in one.warnings] == ["surface-in-parts"]
    assert "of 1 of them, without a prior," in one.warnings[0].text


@pytest.mark.parametrize(
    ("factor", "text"),
    [(25.4, "25.4 times those of the normals"), (-1.0, "are these depths?"), (1.1, "")],
    ids=["other unit", "depth", "right"],
)
def test_heights_in_another_unit_are_reported(factor: float, text: str) -> None:
    scene = waves(48)
    heights = np.where(scene.mask, factor * scene.height, np.nan).astype(np.float32)
    normals = scene.noisy(np.ones_like(heights), 1)
    found = integrate(normals, prior=HeightPrior.from_map(heights, 1.0, (48, 48)))
    codes = [notice.code for notice in found.warnings]
    assert codes == (["prior-doubtful"] if text else ["prior-drift"])
    assert text in "".join(notice.text for notice in found.warnings)


def deviations(size: int, seeds: range, predicted_on: int) -> tuple[float, dict[int, float]]:
    """Return predicted over actual deviations of heights, and of differences by distance."""
    scene = waves(size)
    x = np.mgrid[:size, :size][1]
    sigma = (1 + 2 * x / size).astype(np.float32)
    found = integrate(scene.noisy(sigma, predicted_on), sigma_deg=sigma, height_errors=True)
    assert found.uncertainty is not None
    squares = np.zeros(scene.mask.shape)
    differences = dict.fromkeys(found.uncertainty.distances_px, 0.0)
    for seed in seeds:
        surface = integrate(scene.noisy(sigma, seed), sigma_deg=sigma)
        error = np.where(surface.mask, surface.height - scene.height, np.nan)
        error -= np.nanmean(error)
        squares += error**2
        for distance in differences:
            steps = error[:, distance:] - error[:, :-distance], error[distance:] - error[:-distance]
            pairs = np.concatenate([step.ravel() for step in steps])
            differences[distance] += float(np.nanmean(pairs**2))
    actual = np.nanmean(squares) / len(seeds)
    predicted = np.nanmean(np.square(found.uncertainty.sigma, dtype=np.float64))
    table = zip(differences.items(), found.uncertainty.difference_sigma, strict=True)
    ratios = {distance: sigma / np.sqrt(total / len(seeds)) for (distance, total), sigma in table}
    return float(np.sqrt(predicted / actual)), ratios


def test_predicted_deviations_are_the_actual_ones() -> None:
    heights, differences = deviations(64, range(1, 7), 0)
    assert 0.75 < heights < 1.3
    assert 0.9 < differences[1] < 1.1
    assert 0.8 < differences[10] < 1.25


@pytest.mark.slow
def test_predicted_deviations_over_20_seeds() -> None:
    heights, differences = deviations(220, range(101, 121), 100)
    assert 0.8 < heights < 1.25
    assert all(0.8 < differences[distance] < 1.25 for distance in (1, 10, 100))


def test_a_common_error_of_the_normals_tilts_the_surface() -> None:
    normals, sigma = flat(40, 60), np.full((40, 60), 1, np.float32)
    found = integrate(normals, sigma_deg=sigma, common_sigma_deg=1.0, height_errors=True)
    assert found.uncertainty is not None
    slope = np.radians(1) / np.sqrt(2)
    for distance, actual in zip(
        found.uncertainty.distances_px, found.uncertainty.difference_sigma, strict=True
    ):
        assert actual / (distance * slope) == pytest.approx(1, abs=0.3)  # of 24 samples
    below, above = (
        integrate(normals, sigma_deg=sigma, common_sigma_deg=part, height_errors=True).uncertainty
        for part in (0.0, np.full((40, 60), 0.1))
    )
    assert below is not None
    assert above is not None
    assert above.difference_sigma[0] == pytest.approx(below.difference_sigma[0], rel=0.05)
    assert above.difference_sigma[-1] > below.difference_sigma[-1]


def test_deviations_with_a_prior_and_a_camera() -> None:
    camera = CameraModel(np.array([[200.0, 0, 24], [0, 200.0, 24], [0, 0, 1]]), 48, 48, 400.0)
    normals, sigma = flat(48, 48), np.full((48, 48), 1, np.float32)
    free = integrate(normals, camera=camera, sigma_deg=sigma, height_errors=True).uncertainty
    same = integrate(normals, pixel_mm=2, sigma_deg=sigma, height_errors=True).uncertainty
    assert free is not None
    assert same is not None
    np.testing.assert_allclose(np.nanmedian(free.sigma), np.nanmedian(same.sigma), rtol=0.1)
    points = HeightPrior.from_points([[5, 5], [40, 40]], [0, 0], 3.0, (48, 48))
    held = integrate(normals, camera=camera, sigma_deg=sigma, prior=points, height_errors=True)
    assert held.uncertainty is not None
    # The mean of two heights of 3 mm, from 24 samples.
    assert 1.5 < np.median(held.uncertainty.sigma) < 2.8
    fixed = replace(points, sigma=points.sigma / 1000)
    held = integrate(normals, camera=camera, sigma_deg=sigma, prior=fixed, height_errors=True)
    assert held.uncertainty is not None
    assert held.uncertainty.sigma[5, 5] < 0.005 < np.median(held.uncertainty.sigma) / 4


def at(column: float, height: float) -> HeightPrior:
    return HeightPrior.from_points([[column, 1]], [height], 1, (9, 9))


def mapped(heights: Float64, sigma: float = 1) -> HeightPrior:
    return HeightPrior.from_map(heights, sigma, (9, 9))


REFUSED: dict[str, tuple[Callable[[], dict[str, object]], str]] = {
    "size": (lambda: {"sigma_deg": np.ones((3, 3))}, "do not fit normals"),
    "common size": (lambda: {"common_sigma_deg": np.ones((3, 3))}, "common .* do not fit"),
    "common sign": (lambda: {"common_sigma_deg": -1.0}, "common .* negative"),
    "negative": (lambda: {"sigma_deg": -np.ones((9, 9))}, "negative"),
    "no deviations": (lambda: {"height_errors": True}, "require standard dev"),
    "size of prior": (
        lambda: {"prior": HeightPrior.from_map(np.ones((3, 3)), 1, (3, 3))},
        "does not fit a normal map",
    ),
    "behind": (lambda: {"prior": at(1, 500), "camera": NARROW}, "behind the camera"),
    "outside the image": (lambda: {"prior": at(9, 500)}, "is inside the image of 9 x 9"),
    "outside the mask": (lambda: {"prior": at(8, 500)}, "inside the mask"),
    "empty": (lambda: {"prior": mapped(np.full((9, 9), np.nan))}, "contains no height"),
    "no deviation": (lambda: {"prior": mapped(np.ones((9, 9)), 0)}, "no positive standard dev"),
    "one deviation": (lambda: {"prior": HeightPrior(ONES, 0.5)}, "deviations of shape .. do not"),
    "other shape": (lambda: {"prior": mapped(np.ones((4, 9)))}, "same area"),
    "nan": (lambda: {"prior": at(1, np.nan)}, "not valid numbers"),
}
ONES = np.ones((9, 9), np.float32)
NARROW = CameraModel(np.diag([100.0, 100, 1]), 9, 9, 400.0)


@pytest.mark.parametrize("name", REFUSED)
def test_inputs_that_are_refused(name: str) -> None:
    make, text = REFUSED[name]
    normals = flat(9, 9)
    mask = normals.mask.copy()
    mask[:, 8] = False
    with pytest.raises(DataError, match=text):
        integrate(NormalMap.from_vectors(normals.normals, mask), **make())
