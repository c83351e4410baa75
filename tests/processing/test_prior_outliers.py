"""Known heights with gross errors: which are left out, and which are not."""

from __future__ import annotations

import numpy as np
import pytest

from processing import HeightPrior, NormalMap, integrate
from processing.surface.prior_outliers import prior_outliers

SIZE = (60, 80)
Y, X = np.mgrid[: SIZE[0], : SIZE[1]]
RNG = np.random.default_rng(3)
PLACES = np.unique(RNG.integers(0, 60, (40, 2)), axis=0)[:30]


@pytest.mark.parametrize(
    ("count", "errors", "expected"),
    [
        pytest.param(5, {}, [], id="none"),
        pytest.param(5, {2: 50.0}, [2], id="one of five"),
        pytest.param(3, {2: 50.0}, [], id="one of three"),
        pytest.param(30, {4: 3.0, 17: -20.0}, [4, 17], id="two of thirty"),
        pytest.param(30, {4: 0.3}, [], id="within the deviations"),
    ],
)
@pytest.mark.parametrize("drift", ["none", "tilt", "bowl"])
def test_isolated_gross_errors_are_found(
    count: int, errors: dict[int, float], expected: list[int], drift: str
) -> None:
    x, y = PLACES[:count, 0] / 60, PLACES[:count, 1] / 60
    off = {"none": 0 * x, "tilt": 2 * x - y, "bowl": x * x + 2 * x * y}[drift]
    off = off + RNG.normal(0, 0.01, count)
    # The tilt or the bowl of five points hides nothing that is far larger.
    off[list(errors)] += list(errors.values())
    image = np.full(SIZE, np.nan)
    image[PLACES[:count, 1], PLACES[:count, 0]] = off
    found = prior_outliers(image, np.full(SIZE, 0.1), np.zeros(SIZE, np.int32))
    chosen = found[PLACES[:count, 1], PLACES[:count, 0]]
    assert np.flatnonzero(chosen).tolist() == expected
    assert found.sum() == len(expected)


def test_points_that_agree_on_a_step_are_kept() -> None:
    image = np.full(SIZE, np.nan)
    image[PLACES[:, 1], PLACES[:, 0]] = RNG.normal(0, 0.01, len(PLACES))
    image[50, 70], image[52, 72] = 20.0, 20.1
    found = prior_outliers(image, np.full(SIZE, 0.1), np.zeros(SIZE, np.int32))
    assert not found.any()


def test_parts_have_no_relation() -> None:
    image = np.full(SIZE, np.nan)
    image[5:55:7, 5:70:8] = 1.0
    image[5:55:7, 45:70:8] = 30.0
    parts = (X > 40).astype(np.int32)
    assert not prior_outliers(image, np.full(SIZE, 0.1), parts).any()


def surface(heights: np.ndarray, **options: object) -> tuple[np.ndarray, list[tuple[str, str]]]:
    """Integrate a bump that is held at known heights; return heights and notices."""
    bump = 8 * np.exp(-((X - 40) ** 2 + (Y - 30) ** 2) / 300)
    down, right = np.gradient(bump)
    normals = NormalMap.from_vectors(np.stack([-right, down, np.ones_like(bump)], -1))
    places = np.array([[10, 10], [40, 30], [70, 50], [20, 45], [60, 12]])
    known = bump[places[:, 1], places[:, 0]]
    prior = HeightPrior.from_points(places, known * heights[0] + heights[1:], 0.1, SIZE)
    found = integrate(normals, prior=prior, **options)
    return found.height - bump, [(one.code, one.text) for one in found.warnings]


GOOD = np.array([1.0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        pytest.param([0, 0, 0, 0, 0, 0], [], id="good"),
        pytest.param([0, 0, 0, 50, 0, 0], ["prior-outliers"], id="outlier"),
        pytest.param([-2, 0, 0, 0, 0, 0], ["prior-doubtful"], id="signs"),
        pytest.param([999, 0, 0, 0, 0, 0], ["prior-doubtful"], id="unit"),
    ],
)
def test_they_are_named(change: list[float], codes: list[str]) -> None:
    off, notices = surface(GOOD + change)
    given = [one for one in notices if one[0].startswith("prior")]
    assert [code for code, _ in given] == codes
    if codes in ([], ["prior-outliers"]):
        assert np.abs(off).max() < 0.3
    if codes == ["prior-outliers"]:
        assert "1 height of the prior, of 5, is left out" in given[0][1]
        assert "column,row 70,50 by 50 px" in given[0][1]


@pytest.mark.parametrize("discontinuity", [None, True])
def test_jumps_that_the_normals_do_not_show_are_errors(discontinuity: bool | None) -> None:
    change = np.array([0, 0, 0, 50, 0, 0])
    off, notices = surface(GOOD + change, discontinuity=discontinuity)
    assert [code for code, _ in notices if code.startswith("prior")] == ["prior-outliers"]
    assert np.abs(off).max() < 0.3
