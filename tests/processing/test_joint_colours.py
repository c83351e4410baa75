"""One normal from the samples of all colours, against the Cramer-Rao bound of all of them."""

import dataclasses

import numpy as np
import pytest

from acquisition import CameraModel, Lights, angle_deg
from calibration import EstimateError, StackNoise
from calibration.radiance import luma
from processing import StereoMaps
from processing.colour.channel_normals import ColourImages, laws_of_colours, solve_colours
from processing.colour.joint_colours import JointNoise, law_of_joint_samples, solve_jointly
from processing.noise.normal_errors import as_uncertainty
from processing.noise.pixel_variances import SolvedStack
from processing.recording.colour_normals import shown_by_colours, variances_of_colours
from processing.stereo import METHODS
from processing.stereo.normals_and_albedo import stereo_of

SIZE = (70, 60)
COUNT = 20
SLOPE, FLOOR = 1e-4, 2.5e-7
# Five stripes of 12 columns; most are dark in one or two channels.
STRIPES = {
    "gray": (0.6, 0.6, 0.6),
    "red": (0.8, 0.05, 0.01),
    "blue": (0.02, 0.1, 0.8),
    "black but for green": (0.0, 0.5, 0.0),
    "dark": (0.05, 0.04, 0.02),
}
COLOURS = np.repeat(np.array(list(STRIPES.values())), 12, axis=0)[None].repeat(SIZE[0], axis=0)
CAMERA = CameraModel(
    np.array([[420.0, 0, 29.5], [0, 420, 34.5], [0, 0, 1]]), 60, 70, working_distance_mm=600
)
INTENSITIES = np.linspace([0.7, 0.8, 1.0], [1.0, 0.9, 0.4], COUNT)
MASK = np.ones(SIZE, bool)


def lights(near):
    turn, z = np.arange(COUNT) * np.pi * (3 - np.sqrt(5)), np.linspace(0.97, 0.72, COUNT)
    r = np.sqrt(1 - z * z)
    way = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    if near:
        return Lights(positions_mm=450 * way, axes=-way, mu=np.ones(COUNT), intensities=INTENSITIES)
    return Lights(directions=way, intensities=INTENSITIES)


def normals():
    y, x = np.indices(SIZE, dtype=float)
    vectors = np.dstack([0.3 * np.sin(x / 7), 0.3 * np.cos(y / 9), np.ones(SIZE)])
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def noise():
    one = StackNoise.of_one_exposure(SLOPE, FLOOR, COUNT)
    return dataclasses.replace(one, colour=True, intensities=INTENSITIES)


def vectors(near):
    points = CAMERA.points_on_plane() if near else np.zeros((*SIZE, 3))
    return lights(near).vectors_at(points)


def recorded(near, seed):
    """Return noisy values ``(N, H, W, 3)``, and their variance."""
    shade = np.clip(np.einsum("nhwc,hwc->nhw", vectors(near), normals()), 0, None)
    signal = shade[..., None] * COLOURS
    strength = INTENSITIES[:, None, None]
    variance = (SLOPE * signal * strength + FLOOR) / strength**2
    rng = np.random.default_rng(seed)
    return (signal + rng.normal(size=signal.shape) * np.sqrt(variance)).astype(np.float32), variance


def solved(values, near=False, method="ls", known=True, joint=True, rows=slice(None)):
    law = noise().rows(rows.start or 0, rows.stop or SIZE[0]) if known else None
    points = CAMERA.points_on_plane()[rows] if near else None
    images = ColourImages(values[:, rows], lights(near), MASK[rows], points, law)
    if joint:
        maps = solve_jointly(images, method, law_of_joint_samples(images, method))
    else:
        maps = solve_colours(images, method, laws_of_colours(images, method))
    fewest = StereoMaps(maps.normals, luma(maps.albedo), maps.residual, maps.fewest_used())
    return stereo_of(fewest, images.mask, images.values.max(axis=-1)), maps.albedo


def errors(result):
    """Return the rms error of each stripe in degrees; pixels without a normal count as 90."""
    found = result[0].normal_map
    squares = np.where(found.mask, angle_deg(found.normals, normals()), 90.0) ** 2
    return np.sqrt(squares.reshape(SIZE[0], 5, 12).mean(axis=(0, 2)))


def bounds(near, variance, measured=None):
    """Return the bound of the rms error of each stripe, for unknown colours."""
    of_light, n = vectors(near), normals()
    weight = COLOURS**2 / variance
    if measured is not None:
        weight = weight * measured
    information = np.zeros((*SIZE, 3, 3))
    for k in range(3):
        one = np.einsum("nhw,nhwi,nhwj->hwij", weight[..., k], of_light, of_light)
        # The albedo of a channel explains a part of its samples.
        along = np.einsum("hwij,hwj->hwi", one, n)
        scale = np.einsum("hwi,hwi->hw", along, n)[..., None, None]
        information += one - along[..., None] * along[..., None, :] / np.maximum(scale, 1e-12)
    variances = np.sum(1 / np.linalg.eigvalsh(information)[..., 1:], axis=-1)
    return np.degrees(np.sqrt(variances.reshape(SIZE[0], 5, 12).mean(axis=(0, 2))))


@pytest.mark.parametrize(
    ("near", "methods"), [(False, METHODS), (True, ("ls",))], ids=["distant", "near"]
)
def test_every_method_reaches_the_bound_of_all_samples(near, methods):
    values, variance = recorded(near, seed=11)
    bound = bounds(near, variance)
    apart = errors(solved(values, near, joint=False)) / bound
    for method in methods:
        ratio = errors(solved(values, near, method)) / bound
        assert (ratio > 0.9).all()
        assert (ratio < 1.05).all(), (method, ratio)
        assert (ratio < 1.005 * apart).all(), (method, ratio, apart)


def test_the_albedo_has_the_colours_of_the_stripes():
    _, albedo = solved(recorded(False, seed=12)[0])
    means = albedo.reshape(SIZE[0], 5, 12, 3).mean(axis=(0, 2))
    np.testing.assert_allclose(means, list(STRIPES.values()), atol=2e-4)


def test_a_sample_that_is_saturated_in_one_colour_is_made_of_the_others():
    values, variance = recorded(False, seed=13)
    values[::2, ..., 0] = np.nan
    values[5] = np.nan
    solution = solved(values)
    bound = bounds(False, variance, np.isfinite(values))
    # Stripes of 840 pixels have ratios that differ by 2 %.
    assert (errors(solution) / bound < 1.08).all()
    assert (solution[0].used == COUNT - 1).all()


def shadowed(seed):
    """Return values with cast shadows in up to 30 % of the samples."""
    values, _ = recorded(False, seed=seed)
    rng = np.random.default_rng(seed + 1)
    blocked = rng.uniform(size=values.shape[:3]) < rng.uniform(0, 0.3, SIZE)
    dark = rng.normal(size=values.shape) * np.sqrt(FLOOR) / INTENSITIES[:, None, None]
    return np.where(blocked[..., None], dark, values).astype(np.float32)


def test_a_saturated_colour_with_nearly_all_the_light_is_no_worse_than_solved_apart():
    """Samples of the dim colours are as noisy as outliers, and lights without red are shadows."""
    gray, red = (list(STRIPES).index(name) for name in ("gray", "red"))
    some = shadowed(119)
    everywhere = some.copy()
    some[::3, ..., 0] = np.nan
    everywhere[..., 0][everywhere[..., 0] > 0.4] = np.nan
    for values, stripes in ((some, [red]), (everywhere, [gray, red])):
        for method in ("trimmed", "best"):
            joint = errors(solved(values, method=method))[stripes]
            apart = errors(solved(values, method=method, joint=False))[stripes]
            assert (joint < 1.1 * apart).all(), (method, joint, apart)


@pytest.mark.parametrize(("known", "method"), [(True, "cauchy"), (False, "best")])
def test_errors_are_as_large_as_predicted(known, method):
    """With cast shadows, and with red that is saturated under every third light."""
    values = shadowed(17)
    values[::3, ..., 0] = np.nan
    stereo, albedo = solved(values, method=method, known=known)
    given = SolvedStack(
        values=values,
        lights=lights(False),
        mask=MASK,
        normals=stereo.normal_map.normals,
        albedo=albedo,
        noise=noise() if known else None,
    )
    found = as_uncertainty(variances_of_colours(given, shown_by_colours(given)))
    assert found.valid.all()
    error = angle_deg(stereo.normal_map.normals, normals()).ravel()
    sigma = found.sigma_deg.ravel().astype(float)
    for part in np.array_split(np.argsort(sigma), 5):
        ratio = np.sqrt(np.mean(error[part] ** 2) / np.mean(sigma[part] ** 2))
        assert 0.85 < ratio < 1.2, ratio


def test_without_a_law_all_colours_count_by_their_light():
    values, variance = recorded(False, seed=14)
    ratio = errors(solved(values, known=False)) / bounds(False, variance)
    assert (ratio < 1.2).all(), ratio


def test_outliers_of_one_light_do_not_bend_the_normals():
    values, variance = recorded(False, seed=15)
    values[3:6] += 0.5
    ratio = errors(solved(values, method="cauchy")) / bounds(False, variance)
    assert (ratio < 1.5).all(), ratio


def test_bands_of_rows_equal_the_whole():
    values, _ = recorded(True, seed=16)
    whole, albedo = solved(values, near=True)
    for rows in (slice(0, 33), slice(33, 70)):
        part, colours = solved(values, near=True, rows=rows)
        np.testing.assert_array_equal(part.normal_map.normals, whole.normal_map.normals[rows])
        np.testing.assert_array_equal(colours, albedo[rows])


def test_the_law_of_combined_samples_is_their_variance():
    colours = np.tile([0.6, 0.2, 0.1], (2, 3, 1))
    values = np.ones((COUNT, 2, 3, 3), np.float32)
    values[4, 0, 0] = np.nan  # not measured
    values[4, 0, 1, 0] = np.nan
    law = JointNoise.of(noise(), colours, values)
    gray = colours[0, 0] @ [0.2989, 0.587, 0.114]
    found = law.variance(4, np.full((2, 3), gray / 2))
    strength = INTENSITIES[4]
    of_colours = (SLOPE * colours[0, 0] / 2 * strength + FLOOR) / strength**2
    precision = colours[0, 0] ** 2 / of_colours
    expected = gray**2 / np.array([precision.sum(), precision[1:].sum()])
    np.testing.assert_allclose(found[0, 2], expected[0], rtol=1e-6)
    np.testing.assert_allclose(found[0, 1], expected[1], rtol=1e-6)
    assert law.take([3, 4]).variance(1, np.full((2, 3), gray / 2))[0, 1] == found[0, 1]
    assert law.rows(1, 2).variance(4, np.full((1, 3), gray / 2))[0, 1] == found[1, 1]


def test_images_that_are_saturated_everywhere_are_refused():
    values = np.full((COUNT, *SIZE, 3), np.nan, np.float32)
    with pytest.raises(EstimateError, match="not saturated"):
        solved(values)
