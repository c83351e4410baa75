"""Synthesis over a target: periods along the surface, exact copies on flat targets, bad input."""

import cv2
import numpy as np
import pytest

from acquisition import DataError, angle_deg
from processing import NormalMap, combine, synthesize_onto
from tests.processing.scenes import noise, one_thread

PERIOD, PATCH, RADIUS = 12.0, 24, 300.0


def ridges(side=128, angle_deg=0.0):
    """Return waves along a direction, counter-clockwise from X."""
    y, x = np.mgrid[:side, :side]
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    slope = 0.3 * np.sin(2 * np.pi * (cosine * x - sine * y) / PERIOD)
    return NormalMap.from_vectors(np.dstack([slope * cosine, slope * sine, np.ones_like(slope)]))


def facing(x, y, rows=60, columns=60):
    """Return a plane with a normal of these components."""
    return NormalMap.from_vectors(np.tile([x, y, np.sqrt(1 - x * x - y * y)], (rows, columns, 1)))


def flat(rows=60, columns=60):
    return facing(0.0, 0.0, rows, columns)


def period_of(values, places):
    """Return the period of waves at known places along each row: the peak of the spectrum."""
    weights = np.hanning(len(places) + 2)[1:-1] * np.gradient(places)
    periods = np.linspace(6, 30, 2401)
    waves = np.exp(-2j * np.pi * places[:, None] / periods)
    power = np.square(np.abs((values * weights) @ waves)).sum(axis=0)
    return periods[np.argmax(power)]


@pytest.fixture(scope="module")
def cylinder():
    """Return a cylinder seen from the side, and the arc length and tilt of its columns."""
    x = np.arange(-290, 291) / RADIUS
    row = np.stack([x, 0 * x, np.sqrt(1 - x * x)], axis=-1)
    normals = np.tile(row, (60, 1, 1))
    return NormalMap.from_vectors(normals), RADIUS * np.arcsin(x), np.degrees(np.arcsin(x))


@pytest.mark.parametrize("seed", [101, 102, 103])
def test_a_pattern_keeps_its_period_along_the_arc(cylinder, seed):
    target, arc, tilt = cylinder
    made = synthesize_onto(ridges(), target, patch=PATCH, seed=seed).detail.normals[..., 0]
    for first, last in ((-60, -30), (-30, 0), (0, 30), (30, 60), (-60, 60)):
        part = (tilt >= first) & (tilt <= last)
        found = period_of(made[:, part], arc[part])
        assert found == pytest.approx(PERIOD, rel=0.03), (first, last)


def test_in_the_space_of_the_image_the_pattern_is_stretched(cylinder):
    target, arc, tilt = cylinder
    made = synthesize_onto(ridges(), target, patch=PATCH, image_space=True).detail.normals[..., 0]
    part = (tilt >= 30) & (tilt <= 60)
    assert period_of(made[:, part], arc[part]) > 1.3 * PERIOD
    assert period_of(made[:, part], RADIUS * np.sin(arc[part] / RADIUS)) == pytest.approx(
        PERIOD, rel=0.03
    )


@pytest.mark.parametrize(
    ("plane", "waves_deg", "period"),
    [
        pytest.param((0.0, 0.8), 0.0, PERIOD, id="waves across the tilt"),
        pytest.param((0.0, 0.8), 90.0, 0.6 * PERIOD, id="waves along the tilt"),
        pytest.param((0.48, 0.64), np.degrees(np.arctan2(4, 3)), 0.6 * PERIOD, id="oblique"),
        pytest.param((-0.48, 0.64), np.degrees(np.arctan2(4, 3)) - 180, None, id="other side"),
    ],
)
def test_periods_on_a_tilted_plane(plane, waves_deg, period):
    """The plane is foreshortened along its tilt by the cosine, 0.6, and not across it."""
    made = synthesize_onto(ridges(angle_deg=waves_deg), facing(*plane), patch=PATCH).detail.normals
    # The spectrum of the slopes along the waves.
    along = np.array([np.cos(np.radians(waves_deg)), np.sin(np.radians(waves_deg))])
    slopes = (made[..., :2] @ along) * np.hanning(62)[1:-1, None] * np.hanning(62)[1:-1]
    power = np.abs(np.fft.fft2(slopes, (1024, 1024)))
    row, column = np.unravel_index(np.argmax(power), power.shape)
    wave = np.array([np.fft.fftfreq(1024)[column], -np.fft.fftfreq(1024)[row]])
    wave *= np.sign(wave @ along)
    # A wave k of the pattern is the wave J k in the image; J has eigenvalues 1 / cos and 1.
    tilt = np.array(plane) / 0.8
    expected = along / PERIOD + (1 / 0.6 - 1) * tilt * (tilt @ along) / PERIOD
    np.testing.assert_allclose(wave, expected, atol=0.03 / PERIOD)
    assert period is None or 1 / np.hypot(*expected) == pytest.approx(period)


@pytest.mark.slow
def test_on_a_flat_target_every_vector_is_one_of_the_exemplar():
    exemplar = noise()
    made = synthesize_onto(exemplar, flat(50, 70), patch=16).detail.normals
    # The length of a copied vector may change by the rounding of a float32.
    nearest = np.abs(made.reshape(-1, 1, 3) - exemplar.normals.reshape(1, -1, 3)).max(axis=2)
    assert nearest.min(axis=1).max() < 1e-6


def bowl(mask=None):
    y, x = np.mgrid[1.4:-1.4:70j, -1.4:1.4:80j]
    vectors = np.dstack([x, y, np.ones_like(x)])
    return NormalMap.from_vectors(
        vectors if mask is None else np.where(mask[..., None], vectors, 0)
    )


def test_the_detail_covers_the_mask_and_nothing_else():
    mask = np.hypot(*np.mgrid[-35:35, -40:40]) < 33
    mask[30:40, 20:24] = False
    target = bowl(mask)
    made = synthesize_onto(noise(), target, patch=16, rotate=True, mirror=True)
    np.testing.assert_array_equal(made.detail.mask, mask)
    assert not made.detail.normals[~mask].any()
    lengths = np.linalg.norm(made.detail.normals[mask].astype(np.float64), axis=1)
    np.testing.assert_allclose(lengths, 1, atol=1e-6)
    np.testing.assert_array_equal(combine(target, made.detail).mask, mask)


@pytest.mark.parametrize("size", [0.5, 0.6, 0.8])
def test_a_smaller_pattern_is_as_steep_as_the_exemplar(size):
    """At half its size, the mean over footprints takes 40 % of the power of this pattern."""
    slopes = cv2.GaussianBlur(np.random.default_rng(3).normal(size=(96, 96, 2)), (0, 0), 0.7)
    rough = NormalMap.from_vectors(np.dstack([slopes, np.ones((96, 96))]))
    made = synthesize_onto(rough, flat(96, 96), patch=24, scale=np.full((96, 96), size)).detail
    angles = [angle_deg(n.normals, np.array([0, 0, 1], np.float32)) for n in (made, rough)]
    assert np.mean(angles[0]) == pytest.approx(np.mean(angles[1]), rel=0.05)


def test_the_result_depends_on_the_seed_alone():
    many = synthesize_onto(noise(), bowl(), patch=16, seed=5)
    with one_thread():
        alone = synthesize_onto(noise(), bowl(), patch=16, seed=5)
    np.testing.assert_array_equal(alone.detail.normals, many.detail.normals)
    np.testing.assert_array_equal(alone.labels, many.labels)
    other = synthesize_onto(noise(), bowl(), patch=16, seed=6)
    assert np.mean(angle_deg(other.detail.normals, many.detail.normals)) > 1


def test_a_footprint_that_does_not_fit_is_made_smaller_and_counted():
    steep = facing(0.0, 0.95)
    assert synthesize_onto(noise(), steep, patch=16).compressed == 0
    assert synthesize_onto(noise(), steep, patch=32).compressed > 0.9
    assert synthesize_onto(noise(), steep, patch=32, image_space=True).compressed == 0


@pytest.mark.parametrize(
    ("exemplar", "options", "message"),
    [
        (noise(20), {"patch": 24}, "20 x 20 pixels, less than a patch of 24 x 24"),
        (flat(), {"patch": 12}, "the exemplar is flat"),
        (noise(), {"patch": 5}, "a patch of 5 x 5 pixels is too small"),
        (noise(), {"patch": 12, "overlap": 5}, "overlap by 2 to 4"),
        (noise(), {"seed": -1}, "a seed of -1 is out of range"),
    ],
)
def test_bad_input(exemplar, options, message):
    with pytest.raises(DataError, match=message):
        synthesize_onto(exemplar, flat(), **options)
