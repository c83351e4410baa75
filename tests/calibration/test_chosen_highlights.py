"""Choice among several bright spots on spheres, with exact geometry."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.spheres import Candidates, Highlights, KnownSpheres
from calibration.spheres.position_calibration import choose_highlights

TWO = [((-90, 0, 20), 20.0), ((90, 0, 20), 20.0)]
THREE = [*TWO, ((0, 60, 20), 20.0)]


@pytest.fixture
def choose(bench, dome_mm):
    """Choose with the true highlights and other candidates ``{(light, sphere): [...]}``.

    Each candidate is (x, y) relative to the true highlight, and its share of the flux; the true one
    is (0, 0). The first one is the highlight unless another has more than half of its flux.
    """

    def chosen(spheres, several):
        lights = dome_mm[:8]
        highlights, true = [], []
        for k, (centre, radius) in enumerate(spheres):
            right = np.array([bench.highlight(centre, radius, light) for light in lights])
            pixels = np.full((len(lights), 3, 2), np.nan)
            share = np.full((len(lights), 3), np.nan)
            pixels[:, 0], share[:, 0] = right, 1.0
            found = np.ones(len(lights), bool)
            for (n, at), candidates in several.items():
                if at == k:
                    pixels[n, : len(candidates)] = right[n] + [c[:2] for c in candidates]
                    share[n, : len(candidates)] = [c[2] for c in candidates]
                    found[n] = not np.any(share[n, 1:] > 0.5)
            sigma_px = np.where(np.isfinite(share), 0.05, np.nan)
            of = Candidates(pixels, np.zeros(share.shape, bool), sigma_px, share)
            first = np.where(found[:, None], pixels[:, 0], np.nan)
            one = Highlights(first, np.zeros(len(lights), bool), sigma_px[:, 0], of)
            highlights.append(one)
            true.append(right)
        centres = np.array([c for c, _ in spheres], float)
        radii = np.array([r for _, r in spheres])
        placed = KnownSpheres(centres, radii, np.eye(3 * len(spheres)))
        result, apart_mm2 = choose_highlights(bench.camera, placed, highlights)
        off = [np.linalg.norm(one.pixels - t, axis=1) for one, t in zip(result, true, strict=True)]
        sigmas_mm = np.sqrt(np.trace(apart_mm2, axis1=1, axis2=2))
        return np.stack(off, axis=1), {n: sigmas_mm[n] for n in np.flatnonzero(sigmas_mm)}

    return chosen


@pytest.mark.parametrize("spheres", [TWO, THREE], ids=["two", "three"])
@pytest.mark.parametrize(
    "several",
    [
        pytest.param({}, id="none"),
        pytest.param({(2, 0): [(0, 0, 1.0), (3, 9, 0.9)]}, id="a rival"),
        pytest.param({(2, 0): [(3, 9, 1.0), (0, 0, 0.3)]}, id="a brighter spot"),
        pytest.param({(2, 1): [(3, 9, 1.0), (-8, 6, 0.8), (0, 0, 0.2)]}, id="the third one"),
        pytest.param(
            {(2, 0): [(3, 9, 1.0), (0, 0, 0.7)], (2, 1): [(0, 0, 1.0), (-3, -9, 0.7)]},
            id="on two spheres",
        ),
    ],
)
def test_the_candidates_that_agree_are_chosen(choose, spheres, several):
    off, undecided = choose(spheres, several)
    assert off.max() == 0
    assert not undecided


def test_a_sphere_whose_candidates_all_disagree_has_no_highlight(choose):
    off, undecided = choose(THREE, {(4, 1): [(3, 9, 1.0), (-8, 6, 0.6)]})
    assert np.argwhere(~np.isfinite(off)).tolist() == [[4, 1]]
    assert np.nanmax(off) == 0
    assert not undecided


def test_candidates_that_agree_on_two_spheres_leave_a_light_undecided(bench, dome_mm, choose):
    """Two lamps, seen on both spheres: the brighter one is used, and the error contains the other.

    A third sphere changes nothing.
    """
    apart_mm = np.linalg.norm(dome_mm[5] - dome_mm[1])
    for spheres in (TWO, THREE):
        several = {}
        for k, (centre, radius) in enumerate(spheres):
            shift = bench.highlight(centre, radius, dome_mm[5]) - bench.highlight(
                centre, radius, dome_mm[1]
            )
            several[1, k] = [(0, 0, 1.0), (*shift, 0.8)]
        off, undecided = choose(spheres, several)
        assert off.max() == 0
        likely = 0.8 ** len(spheres)
        sigma_mm = apart_mm * np.sqrt(likely / (1 + likely))
        assert undecided == {1: pytest.approx(sigma_mm, rel=0.01)}


def test_one_sphere_decides_nothing(choose):
    off, undecided = choose(TWO[:1], {(2, 0): [(0, 0, 1.0), (3, 9, 0.9)]})
    assert np.flatnonzero(~np.isfinite(off[:, 0])).tolist() == [2]
    assert not undecided


def test_highlights_without_others_are_their_own_candidates():
    pixels = np.array([[3.0, 4.0], [np.nan, np.nan]])
    one = Highlights(pixels, np.array([True, False]), np.array([0.1, np.nan]))
    assert one.candidates.seen.tolist() == [True, False]
    again = one.chosen(np.array([0, -1]))
    np.testing.assert_array_equal(again.pixels, pixels)
    assert again.saturated.tolist() == [True, False]
    assert not replace(again, several=one.candidates).ambiguous.any()
