"""Errors where the surface is not matte: closed forms on maps of one value."""

import numpy as np
import pytest

from processing.noise.pixel_variances import common_error, model_errors, row_sums

SIZE, FREE, PAIRED, TOTAL = (9, 9), 30.0, 10.0, 2e-4


def found(alike, left=1.0):
    """Return variance and share kept in the middle; half of the variance is that of the lights."""
    maps = (TOTAL / 2, TOTAL / 2, 2 * FREE, FREE, left * FREE, alike * PAIRED, PAIRED)
    model, kept = model_errors(*(np.full(SIZE, value, np.float32) for value in maps))
    return float(model[4, 4]), float(kept[4, 4])


# Sums over 5 x 5 pixels; the lights explain half, and 4 standard deviations more are noise.
NOISE = 4 * (1 / np.sqrt(25 * PAIRED) + 0.5 * np.sqrt(2 / FREE))
LIMIT = 0.5 + NOISE


@pytest.mark.parametrize("left", [2.0, 1.0, 0.0])
def test_residuals_that_are_alike_beyond_their_noise_are_errors_of_the_model(left):
    assert found(LIMIT - 0.02, left) == (0, 1)
    alike, prior, free = LIMIT + NOISE + 0.02, 50, 25 * FREE
    share = ((left * free + prior) / (2 * free + prior)) ** 3
    model, kept = found(alike, left)
    assert kept == pytest.approx(share, rel=1e-5)
    assert model == pytest.approx(1.6 * share * (alike - 0.5) * TOTAL * (FREE + 3), rel=1e-4)


def test_the_error_has_no_step_where_residuals_begin_to_be_alike():
    """Patches of pixels next to the limit had 3.3 degrees, the others around them 1.0."""
    models = [found(LIMIT + part * NOISE, 2.0)[0] for part in (1e-3, 0.25, 0.5, 1.001)]
    full = [1.6 * (NOISE * (1 + part)) * TOTAL * (FREE + 3) for part in (1e-3, 0.25, 0.5, 1.001)]
    shares = np.divide(models, full)
    np.testing.assert_allclose(shares, [1e-3, 0.25, 0.5, 1], atol=2e-3)


def row_sums_of(model, noise, lights, products, paired):
    """Return the sums of maps of one value, except for those of the model and the noise."""
    shape = np.shape(noise)
    free, alike, pairs = (np.full(shape, v, np.float32) for v in (FREE, products, paired))
    of_lights = np.full(shape, lights, np.float32)
    return row_sums(
        np.float32(model), np.float32(noise), of_lights, [free, free, free, alike, pairs]
    )


def test_the_mean_deviation_counts_pixels_with_a_solution():
    model, noise = [[4e-4, 1e-4], [9e-4, 0]], [[1, 1], [1, 0]]
    sums = row_sums_of(model, noise, 0, 0, 0)
    assert common_error(sums) == pytest.approx((0.7 * 0.06 / 3) ** 2)
    assert common_error(0 * sums) == 0


@pytest.mark.parametrize(
    ("alike", "part"),
    [(0.0, 0.0), (0.005, 0.0), (0.0075, 0.5), (0.02, 1.0), (0.9, 1.0)],
    ids=["none", "noise", "half", "below the noise of a pixel", "limit"],
)
def test_deviations_below_the_noise_of_a_pixel_show_in_the_mean(alike, part):
    """The mean of 640,000 products has a deviation of .00125, of which 4 are noise."""
    total = 1e-4
    sums = row_sums_of(np.zeros((160, 400)), np.full((160, 400), total), 0, 10 * alike, 10)
    expected = min(6 * part * alike * (FREE + 3), 4)
    assert common_error(sums) == pytest.approx(total * expected, rel=1e-3, abs=1e-9)


def test_errors_of_lights_are_no_deviations_of_the_surface():
    shape = (160, 400)
    for alike, named in ((0.5, False), (0.7, False), (2.6, True)):
        sums = row_sums_of(np.zeros(shape), np.full(shape, 1e-4), 1e-4, 10 * alike, 10)
        assert (common_error(sums) > 0) == named
