"""Grounds: cork, wood, print and cloth are deterministic, seeded, and have the stated scale."""

import numpy as np
import pytest

from simulator.shapes import Checker, Cork, Print, Weave, Wood

GROUNDS = [Cork, Wood, Print, Weave]


def sampled(ground, step_mm=0.25, size=200):
    x, y = np.meshgrid(step_mm * np.arange(size) - 17.0, step_mm * np.arange(size) - 31.0)
    return ground.evaluate(x, y)


@pytest.mark.parametrize("kind", GROUNDS)
def test_a_ground_depends_on_position_and_seed_alone(kind):
    whole, again = sampled(kind(seed=5)), sampled(kind(seed=5))
    np.testing.assert_array_equal(whole, again)
    one = kind(seed=5).evaluate(np.array([0.25 * 40 - 17.0]), np.array([0.25 * 50 - 31.0]))
    assert one[0] == whole[50, 40]
    assert np.mean(np.abs(whole - sampled(kind(seed=6)))) > 0.01
    assert 0 <= whole.min() < whole.max() <= 1
    assert whole.std() > 0.05
    assert kind.sharp


@pytest.mark.parametrize("kind", [Cork, Wood, Weave])
def test_a_coloured_ground_has_three_channels(kind):
    grey, colour = sampled(kind(0.1, 0.6)), sampled(kind((0.1, 0.1, 0.1), (0.6, 0.3, 0.2)))
    assert colour.shape == (*grey.shape, 3)
    np.testing.assert_allclose(colour[..., 0], grey, atol=1e-12)


def test_a_turned_ground_is_the_ground_turned():
    x, y = np.random.default_rng(0).uniform(-40, 40, (2, 500))
    for kind in (Wood, Print, Weave, Checker):
        np.testing.assert_allclose(
            kind(angle_deg=90.0).evaluate(-y, x), kind().evaluate(x, y), atol=1e-6
        )


def test_yarns_repeat_in_places_and_words_have_gaps():
    weave = Weave(yarn_mm=2.0)
    at = 2.0 * np.arange(40)
    middles = weave.evaluate(at + 1.0, np.full(40, 1.0))
    assert np.all(middles > 0.1 + 0.5 * 0.69)
    # The gap between yarns is as dark as stated.
    np.testing.assert_allclose(weave.evaluate(at + 0.01, np.full(40, 0.01)), 0.1)
    marks = sampled(Print(), step_mm=0.2, size=600)
    assert 0.1 < (marks < 0.4).mean() < 0.35


def test_checker_can_be_shifted():
    x, y = np.array([4.0, 2.0, 4.0]), np.array([5.0, 5.0, 3.0])
    albedo = Checker(0.2, 0.8, 10.0, shift_mm=(3.0, 4.0)).evaluate(x, y)
    np.testing.assert_allclose(albedo, [0.8, 0.2, 0.2])
