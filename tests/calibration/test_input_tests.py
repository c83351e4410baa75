"""Given values that contradict the images are named, with both explanations of a wrong ratio."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from acquisition import DataError
from calibration.spheres.judge.input_tests import (
    DISTORTION,
    FOCAL,
    RATIO,
    InputTest,
    doubts,
    factor_of,
    known_places,
)
from tests.calibration.conftest import dome

BENCHMARK = "wrong_inputs"
RADII = np.full(4, 20.0)


DOME = np.array(dome())


@pytest.mark.parametrize(
    ("kind", "size", "change", "code"),
    [
        pytest.param("", 0.0, 0.0, None, id="correct"),
        pytest.param(RATIO, 0.01, -0.01, "ratio-contradicted", id="ratio"),
        pytest.param(FOCAL, 0.01, -0.01, "focal-length-contradicted", id="focal"),
        pytest.param(DISTORTION, 0.1, 0.1, "distortion-contradicted", id="distortion"),
    ],
)
def test_a_wrong_value_is_estimated_and_named(benchmark, bench, kind, size, change, code):
    tests = benchmark.trial(4, kind, size, seed=2)
    warnings, _ = doubts(tests, bench.camera, RADII)
    if code is None:
        assert warnings == []
        assert all(test.sigmas < 3.3 for test in tests)
        return
    (own,) = (test for test in tests if test.name == kind)
    assert own.change == pytest.approx(change, rel=0.2)
    # Ratio and focal length change the sizes alike: only together with the other may one be named.
    assert own.sigmas**2 > tests[0].sigmas ** 2 - 9
    assert len(warnings) == 1
    if kind == DISTORTION:
        assert warnings[0].code == code


def claim(name, change, sigma):
    return InputTest(name, change, sigma, DOME)


def test_both_explanations_of_a_ratio_are_named(bench):
    tests = [claim(RATIO, 0.01, 0.001), claim(FOCAL, 0.001, 0.001)]
    (warning,), _ = doubts(tests, bench.camera, RADII)
    assert warning.code == "ratio-contradicted"
    both = "radius 20.20 mm (+1.00 +- 0.10 %), or working distance 594.1 mm (-0.99 +- 0.10 %); "
    assert both in warning.text
    assert "focal" not in warning.text
    (several,), _ = doubts(tests, bench.camera, np.array([20.0, 16.0]))
    assert "all radii times 1.0100 (+1.00 +- 0.10 %), or working distance" in several.text


def test_explanations_that_are_as_good_are_named_too(bench):
    tests = [claim(FOCAL, 0.01, 0.001), claim(RATIO, 0.0098, 0.001)]
    (warning,), _ = doubts(tests, bench.camera, RADII)
    assert warning.code == "focal-length-contradicted"
    assert "focal length 5050.0 +- 5.0 px, or radius 20.20 mm" in warning.text
    (alone,), _ = doubts([tests[0], claim(RATIO, 0.009, 0.001)], bench.camera, RADII)
    assert "radius" not in alone.text


@pytest.mark.parametrize(("sigmas", "says"), [(3.2, False), (3.4, True)])
def test_a_value_is_doubted_from_3_3_standard_deviations(bench, sigmas, says):
    tests = [claim(DISTORTION, -0.01 * sigmas, 0.01)]
    assert bool(doubts(tests, bench.camera, RADII)[0]) == says


@pytest.mark.parametrize("size", [0.02, -0.05])
@pytest.mark.parametrize("kind", ["ratio", "distance"])
def test_known_places_decide_between_radius_and_distance(benchmark, bench, kind, size):
    """Places with a scatter of 5 mm that are turned and shifted as a whole."""
    tests = benchmark.trial(4, kind, size, seed=3)
    (undecided,), _ = doubts(tests, bench.camera, RADII * (1 + size))
    assert "radius" in undecided.text
    assert "working distance" in undecided.text
    rng = np.random.default_rng(8)
    turn = Rotation.from_euler("xyz", [2.0, -3.0, 5.0], degrees=True)
    places = turn.apply(DOME + rng.normal(0, 5, DOME.shape)) + np.array([10.0, -5.0, 8.0])
    # Half of the places are enough.
    places[::2] = np.nan
    given = RADII * (1 + size if kind == "ratio" else 1)
    (decided,), _ = doubts(tests, bench.camera, given, places)
    kept, _, excluded = decided.text.partition("led_positions_mm exclude")
    assert ("radius" in kept) == (kind == "ratio")
    assert ("working distance" in kept) == (kind == "distance")
    assert ("working distance" in excluded) == (kind == "ratio")
    assert decided.code == "ratio-contradicted"


@pytest.mark.parametrize(
    ("places", "says"),
    [
        pytest.param(DOME[::-1], "", id="wrong order"),
        pytest.param(0.99 * DOME, "do not decide between them", id="between both"),
        pytest.param(1.2 * DOME, "none of this agrees with led_positions_mm", id="another scale"),
        pytest.param(np.full_like(DOME, np.nan), "", id="none known"),
    ],
)
def test_places_that_agree_with_nothing_exclude_nothing(bench, places, says):
    (warning,), _ = doubts([claim(RATIO, 0.02, 0.001)], bench.camera, RADII, places)
    assert "radius 20.40 mm (+2.00 +- 0.10 %), or working distance 588.2 mm" in warning.text
    assert says in warning.text
    assert ("led_positions_mm" in warning.text) == bool(says)


def test_the_factor_of_lights_to_places_has_its_standard_deviation():
    rng = np.random.default_rng(6)
    found = [factor_of(1.01 * DOME, DOME + rng.normal(0, 10, DOME.shape)) for _ in range(300)]
    off = np.array([one.factor - 1.01 for one in found])
    # The error in common does not show in these draws.
    own = np.sqrt(np.mean([one.sigma**2 for one in found]) - 0.003**2)
    assert abs(off.mean()) < 3 * own / np.sqrt(300)
    assert off.std() == pytest.approx(own, rel=0.15)
    assert factor_of(DOME[:3], DOME[:3]) is None
    assert factor_of(-DOME, DOME) is None


def test_a_wrong_place_is_refused():
    with pytest.raises(DataError, match="position of LED L03 must be 3 finite numbers"):
        known_places({"L03": (1.0, 2.0)}, ("L03",))
    assert np.isnan(known_places({"L07": (1, 2, 3)}, ("L03",))).all()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_false_warnings_are_rare(benchmark, bench):
    """At most 2 % of 100 seeds: 0.3 % are expected."""
    wrong = [
        seed
        for seed in range(5000, 5100)
        if doubts(benchmark.trial(4, "", 0.0, seed), bench.camera, RADII)[0]
    ]
    assert len(wrong) <= 2, wrong
