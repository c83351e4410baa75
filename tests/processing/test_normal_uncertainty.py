"""Error bars of normals, and kinds of samples, on surfaces whose truth is known."""

import dataclasses

import numpy as np
import pytest

from acquisition import CameraModel, DataError, LightErrors, Lights, angle_deg
from acquisition.values import tangent_basis
from calibration import StackNoise
from processing import SampleKind, photometric_stereo
from processing.noise import UNIFORM_DEG, Reason, normal_uncertainty
from processing.noise.light_table import light_table, near_variances
from processing.noise.normal_errors import in_degrees
from processing.noise.pixel_variances import SolvedStack
from processing.stereo import METHODS
from tests.processing.scenes import dome, half_ball
from tests.quick_sample import quick

SLOPE, FLOOR = 1e-4, 2.5e-7
COUNT = 24


def law(count=COUNT):
    return StackNoise.of_one_exposure(SLOPE, FLOOR, count)


def lights_of(count=COUNT):
    return Lights(dome(count, 0.97, 0.4))


def noisy(images, seed):
    rng = np.random.default_rng(seed)
    return images + rng.normal(size=images.shape) * np.sqrt(FLOOR + SLOPE * np.maximum(images, 0))


@pytest.fixture(scope="module")
def shadowed():
    """Return lights, normals, mask, images and cast shadows of a ball."""
    normals, mask = half_ball(56, 0.9)
    lights = lights_of()
    shading = np.clip(np.einsum("nc,hwc->nhw", lights.unit_directions, normals), 0, None)
    rng = np.random.default_rng(90)
    blocked = rng.uniform(size=shading.shape) < rng.uniform(0, 0.3, mask.shape)
    albedo = rng.uniform(0.2, 0.9, mask.shape)
    return lights, normals, mask, np.where(blocked, 0, albedo * shading), blocked


def ratio(actual, predicted):
    return np.sqrt(np.mean(actual**2) / np.mean(predicted.astype(float) ** 2))


def parts(actual, predicted, number):
    order = np.array_split(np.argsort(predicted), number)
    return [ratio(actual[part], predicted[part]) for part in order]


@pytest.mark.parametrize("known", [True, False], ids=["known", "unknown"])
@pytest.mark.parametrize("method", METHODS)
def test_errors_are_as_large_as_predicted(shadowed, method, known):
    lights, normals, mask, images, _ = shadowed
    noise = law() if known else None
    values = noisy(images, 91)
    stereo = photometric_stereo(values, lights, mask, method=method, noise=noise)
    found = normal_uncertainty(values, lights, mask, stereo, noise=noise)
    assert found.noise == ("sensor" if known else "residuals")
    error = angle_deg(stereo.normal_map.normals, normals)
    valid = found.valid
    assert valid[mask].mean() > 0.99
    assert np.isnan(found.sigma_deg[~valid]).all()
    every = parts(error[valid], found.sigma_deg[valid], 5)
    assert min(every) > 0.85, every
    assert max(every) < 1.2, every


def test_errors_of_brackets_are_as_large_as_predicted(shadowed):
    lights, normals, mask, images, _ = shadowed
    # The second exposure is 16 times shorter. White of the first is at a third of the signal.
    shorter = np.array([1.0, 16.0])
    noise = StackNoise(
        slope=SLOPE * np.ones((COUNT, 1)) * shorter,
        floor=FLOOR * np.ones((COUNT, 1)) * shorter**2,
        limit=np.ones((COUNT, 1)) * [0.3, np.inf],
        intensities=np.ones((COUNT, 3)),
        site_factor=np.ones((1, 1, 3)),
        colour=False,
        origin="sensor",
    )
    rng = np.random.default_rng(96)
    deviation = np.sqrt([noise.variance(i, image) for i, image in enumerate(images)])
    values = images + deviation * rng.normal(size=images.shape)
    stereo = photometric_stereo(values, lights, mask, noise=noise)
    found = normal_uncertainty(values, lights, mask, stereo, noise=noise)
    error = angle_deg(stereo.normal_map.normals, normals)[found.valid]
    every = parts(error, found.sigma_deg[found.valid], 5)
    assert min(every) > 0.85, every
    assert max(every) < 1.2, every


def kinds_of(values, lights, mask, stereo, noise):
    """Return the kind of every sample inside the mask, ``(N, M)``."""
    solved = SolvedStack(
        values=values.astype(np.float32),
        lights=lights,
        mask=mask,
        normals=stereo.normal_map.normals,
        albedo=stereo.albedo,
        noise=noise,
    )
    pixels = np.flatnonzero(mask)
    return solved.solver().solve(pixels, *solved.samples(pixels, solved.fitted_law()))[0].T


def test_kinds_are_those_of_the_scene(shadowed):
    lights, normals, mask, images, blocked = shadowed
    facing = np.einsum("nc,hwc->nhw", lights.unit_directions, normals)
    clear = mask & (np.abs(facing) > 0.02).all(axis=0)
    values = noisy(images, 92)
    values[3, 20:30, 20:30] = np.nan
    values[5, 30:36, 20:30] += 0.8
    expected = np.where(blocked, SampleKind.CAST, SampleKind.LIT)
    expected = np.where(facing < 0, SampleKind.ATTACHED, expected)
    expected[3, 20:30, 20:30] = SampleKind.SATURATED
    expected[5, 30:36, 20:30] = SampleKind.OUTLIER
    for method in METHODS:
        stereo = photometric_stereo(values, lights, mask, method=method)
        for noise in (law(), None):
            kinds = kinds_of(values, lights, mask, stereo, noise)
            agree = (kinds == expected[:, mask])[:, clear[mask]]
            assert agree.mean() > 0.99, (method, noise)
    counts = normal_uncertainty(values, lights, mask, stereo).samples
    np.testing.assert_array_equal(counts.sum(axis=0), np.where(mask, COUNT, 0))


def draws(lights, spread, intensity, rng):
    """Return lights with stated errors, drawn from them, and factors of the images."""
    count, basis = len(lights), tangent_basis(lights.unit_directions)
    shift = np.einsum("nk,nkc->nc", spread * rng.normal(size=(count, 2)), basis)
    errors = LightErrors(np.tile(spread**2 * np.eye(2), (count, 1, 1)), np.full(count, intensity))
    moved = Lights(lights.unit_directions + shift, errors=errors)
    return moved, 1 + intensity * rng.normal(size=count)


@pytest.mark.parametrize("known", quick([True, False], every=2), ids=["known", "unknown"])
def test_errors_of_the_lights_are_predicted(known):
    normals, mask = half_ball(20, 0.9)
    lights = lights_of()
    images = 0.6 * np.clip(np.einsum("nc,hwc->nhw", lights.unit_directions, normals), 0, None)
    rng = np.random.default_rng(93)
    error, sigma, common = [], [], []
    for draw in range(40):
        moved, factor = draws(lights, 0.02, 0.02, rng)
        values = noisy(images * factor[:, None, None], 1000 + draw)
        noise = law() if known else None
        stereo = photometric_stereo(values, moved, mask, method="cauchy", noise=noise)
        found = normal_uncertainty(values, moved, mask, stereo, noise=noise)
        error.append(angle_deg(stereo.normal_map.normals, normals)[found.valid])
        sigma.append(found.sigma_deg[found.valid])
        common.append(found.common_sigma_deg[found.valid])
    every = parts(np.concatenate(error), np.concatenate(sigma), 3)
    assert min(every) > 0.85, every
    assert max(every) < 1.2, every
    assert np.median(np.concatenate(common)) > 0.5 * np.median(np.concatenate(sigma))


NEAR = Lights(
    positions_mm=[[300, 40, 250], [-200, 250, 300]],
    axes=[[-300, 0, -250], [200, -200, -300]],
    mu=[1.0, 2.3],
)
POINT, NORMAL = np.array([30.0, -20.0, 12.0]), np.array([0.2, -0.3, 0.7])


def shade(lights=NEAR, point=POINT):
    return lights.vectors_at(point) @ NORMAL


def change(**fields):
    return shade(dataclasses.replace(NEAR, **fields)) - shade()


def test_near_lights_move_samples_as_finite_differences_say():
    step = 1e-3
    slopes = np.stack(
        [change(positions_mm=NEAR.positions_mm + step * unit) / step for unit in np.eye(3)], axis=1
    )
    covariance = np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.5], [0.5, -0.5, 6.0]])
    across = tangent_basis(NEAR.axes)
    turned = np.stack(
        [change(axes=NEAR.axes + step * across[:, k]) / step for k in range(2)], axis=1
    )
    cases = {
        "position": (
            LightErrors(np.tile(covariance, (2, 1, 1))),
            np.einsum("ni,ij,nj->n", slopes, covariance, slopes),
        ),
        "intensity": (LightErrors(intensity_std=np.full(2, 0.05)), (0.05 * shade()) ** 2),
        "axis": (
            LightErrors(axis_std_deg=np.full(2, 2.0)),
            np.radians(2.0) ** 2 * (turned**2).sum(axis=1),
        ),
        "mu": (
            LightErrors(mu_std=np.full(2, 0.1)),
            (0.1 * change(mu=NEAR.mu + step) / step) ** 2,
        ),
    }
    view = np.array([0.0, 0.0, 600.0, 0.001])
    moved = shade(point=POINT + 1e-3 * view[3] * (view[:3] - POINT)) - shade()
    for name, (errors, expected) in cases.items():
        table = light_table(dataclasses.replace(NEAR, errors=errors))
        variances, higher = np.zeros((2, 2), np.float32)
        vectors = np.ascontiguousarray(NEAR.vectors_at(POINT).T, np.float32)
        near_variances(table, vectors, POINT, view, NORMAL, variances, higher)
        np.testing.assert_allclose(variances, expected, rtol=2e-3, err_msg=name)
        np.testing.assert_allclose(higher, moved / 1e-3, rtol=1e-3)


def test_an_error_of_the_height_turns_normals_as_predicted():
    size = (20, 24)
    camera = CameraModel(
        np.array([[90.0, 0, 11.5], [0, 90, 9.5], [0, 0, 1]]), 24, 20, working_distance_mm=600
    )
    away = lights_of(16).unit_directions * 450
    lights = Lights(positions_mm=away)
    normals = np.broadcast_to([0.1, 0.0, np.sqrt(0.99)], (*size, 3))
    points = camera.points_at(np.full(size, 580.0))
    values = 0.5 * np.maximum(np.sum(lights.vectors_at(points) * normals, axis=-1), 0)
    mask = np.ones(size, bool)
    noise = law(16)
    stereo = photometric_stereo(values, lights, mask, points_mm=points, noise=noise)

    def bars(sigma):
        return normal_uncertainty(
            values, lights, mask, stereo, points_mm=points, camera=camera, depth_sigma=sigma,
            noise=noise,
        )  # fmt: skip

    exact, doubtful = bars(0.0), bars(0.003)
    assert not exact.common_sigma_deg.any()
    moved = camera.points_at(np.full(size, 580.0 * 0.997))
    other = photometric_stereo(values, lights, mask, points_mm=moved, noise=noise)
    turned = angle_deg(other.normal_map.normals, normals)
    np.testing.assert_allclose(doubtful.common_sigma_deg, turned, rtol=0.1, atol=0.01)
    total = np.hypot(exact.sigma_deg, doubtful.common_sigma_deg)
    np.testing.assert_allclose(doubtful.sigma_deg, total, rtol=1e-3)
    with pytest.raises(DataError, match="depths with errors require a camera"):
        normal_uncertainty(
            values, lights, mask, stereo, points_mm=points, depth_sigma=0.1, noise=noise
        )


def test_a_pixel_is_invalid_for_a_reason():
    lights = Lights([[1, 0, 1], [0, 1, 1], [-1, 0, 1], [0, -1, 1], [0.7, 0.7, 1], [0, 0, 1]])
    values = np.tile(0.5 * lights.unit_directions[:, 2, None, None], (1, 1, 7))
    values[:4, 0, 1] = np.nan
    values[:4, 0, 2] = 0
    values[:, 0, 3] = [0.35, np.nan, 0.35, np.nan, np.nan, 0.5]
    values[:, 0, 4] = 0
    mask = np.arange(7)[None] != 6
    expected = [
        Reason.VALID, Reason.SATURATED, Reason.SHADOW, Reason.UNSOLVED, Reason.UNSOLVED,
        Reason.VALID, Reason.OUTSIDE,
    ]  # fmt: skip
    for method in METHODS:
        stereo = photometric_stereo(values, lights, np.ones((1, 7), bool), method=method)
        found = normal_uncertainty(values, lights, mask, stereo, noise=law(6))
        assert found.reason[0].tolist() == expected, method
        assert found.valid[0].tolist() == [reason == Reason.VALID for reason in expected]
        assert not found.samples[:, 0, 6].any()


@pytest.fixture(scope="module")
def glossy():
    """Return lights, normals, mask, and images of a matte and of a glossy ball."""
    normals, mask = half_ball(72, 0.9)
    lights = lights_of()
    vectors = lights.unit_directions
    half = vectors + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    shading = 0.5 * np.clip(np.einsum("nc,hwc->nhw", vectors, normals), 0, None)
    lobe = np.clip(np.einsum("nc,hwc->nhw", half, normals), 0, None) ** 20
    return lights, normals, mask, noisy(shading, 94), noisy(shading * (1 + 0.5 * lobe), 94)


@pytest.mark.parametrize("known", [True, False], ids=["known", "unknown"])
def test_errors_by_gloss_are_not_far_below_the_actual_ones(glossy, known):
    """On this ball they are larger: the lobe hardly turns the normals."""
    lights, normals, mask, matte, values = glossy
    noise = law() if known else None
    for method, most in (("cauchy", 1.6), ("trimmed", 1.6), ("best", 2.2)):
        stereo = photometric_stereo(values, lights, mask, method=method, noise=noise)
        found = normal_uncertainty(values, lights, mask, stereo, noise=noise)
        assert found.neighbour_correlation > 0.1
        error = angle_deg(stereo.normal_map.normals, normals)[found.valid]
        every = parts(error, found.sigma_deg[found.valid], 5)
        assert max(every) < most, (method, every)
        predicted = found.sigma_deg[found.valid]
        assert np.hypot.reduce(error) > 0.25 * np.hypot.reduce(predicted), method
    stereo = photometric_stereo(matte, lights, mask, noise=noise)
    plain = normal_uncertainty(matte, lights, mask, stereo, noise=noise)
    assert -0.2 < plain.neighbour_correlation < 0.05
    assert np.nanmedian(found.sigma_deg) > 4 * np.nanmedian(plain.sigma_deg)
    few = normal_uncertainty(values[:7], lights.take(range(7)), mask, stereo)
    assert np.isnan(few.neighbour_correlation)


def test_three_images_show_no_noise():
    lights = lights_of(3)
    values = np.full((3, 4, 5), 0.4)
    stereo = photometric_stereo(values, lights, np.ones((4, 5), bool))
    found = normal_uncertainty(values, lights, np.ones((4, 5), bool), stereo)
    assert found.noise == "unknown"
    assert np.isnan(found.sigma_deg).all()


def test_rows_are_as_in_the_whole(shadowed):
    lights, _, mask, images, _ = shadowed
    values = noisy(images, 95)
    stereo = photometric_stereo(values, lights, mask, noise=law())
    whole = normal_uncertainty(values, lights, mask, stereo, noise=law())
    rows = slice(10, 40)
    part = photometric_stereo(values[:, rows], lights, mask[rows], noise=law())
    found = normal_uncertainty(values[:, rows], lights, mask[rows], part, noise=law())
    np.testing.assert_array_equal(found.samples, whole.samples[:, rows])
    # The agreement with the law is averaged over 5 rows.
    np.testing.assert_allclose(found.sigma_deg[2:-2], whole.sigma_deg[12:38], rtol=1e-4)


@pytest.mark.parametrize(
    ("values", "count", "text"),
    [
        pytest.param((24, 5, 5), 24, "do not fit", id="size"),
        pytest.param((7, 56, 56), 24, "7 images for 24 lights", id="count"),
    ],
)
def test_what_does_not_fit_is_refused(shadowed, values, count, text):
    lights, _, mask, images, _ = shadowed
    stereo = photometric_stereo(images, lights, mask)
    with pytest.raises(DataError, match=text):
        normal_uncertainty(np.ones(values), lights_of(count), mask, stereo)


def test_no_direction_is_less_certain_than_a_uniform_one():
    """The limit is the rms angle to a direction that is uniform on the sphere."""
    uniform = np.random.default_rng(1).normal(size=(200_000, 3))
    angle = np.arctan2(np.linalg.norm(uniform[:, :2], axis=1), uniform[:, 2])
    limit = np.degrees(np.sqrt(np.mean(angle**2)))
    assert abs(UNIFORM_DEG - limit) < 0.5
    variances = np.float32([[1e-4, 4.0, np.inf, np.nan, 1e9]])
    in_degrees(variances, np.array([[True, True, True, True, False]]))
    assert variances[0].tolist() == pytest.approx(
        [np.degrees(0.01), UNIFORM_DEG, UNIFORM_DEG, np.nan, np.nan], nan_ok=True
    )
