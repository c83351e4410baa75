"""Known heights that show a tilt or bend of all normals."""

from __future__ import annotations

import numpy as np
import pytest

from processing import HeightMap, HeightPrior, NormalMap, integrate
from processing.surface.drift import Drift
from rig.arrays import Float64
from tests.cases import cases

SIDE = 160
Y, X = np.mgrid[:SIDE, :SIDE].astype(float)
HEIGHT = 6 * np.sin(X / 25) * np.cos(Y / 31)


def surface(tilt_deg: float, bend_deg: float, points: int, **options: object) -> HeightMap:
    """Return a surface from normals that are turned, through known heights on a grid."""
    down, right = np.gradient(HEIGHT)
    right += np.tan(np.radians(tilt_deg + bend_deg * (2 * X / SIDE - 1)))
    normals = np.dstack([-right, down, np.ones_like(right)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    normals += np.random.default_rng(4).normal(0, np.radians(0.5), normals.shape)
    places = [(x, y) for x in _spread(points) for y in _spread(points)]
    known = [HEIGHT[y, x] for x, y in places]
    prior = HeightPrior.from_points(places, known, 0.01, (SIDE, SIDE))
    return integrate(NormalMap.from_vectors(normals), prior=prior, **options)  # type: ignore[arg-type]


def _spread(count: int) -> list[int]:
    return np.linspace(15, SIDE - 16, count).astype(int).tolist()


def rms(made: HeightMap) -> float:
    return float(np.sqrt(np.nanmean((made.height - HEIGHT) ** 2)))


@cases(
    ("tilt_deg", "bend_deg", "points"),
    {"tilt": (1.0, 0.0, 2), "tilt, nine": (1.0, 0.0, 3), "both": (0.7, 0.7, 3)},
)
@pytest.mark.parametrize("discontinuity", [False, True])
def test_a_turn_of_all_normals_is_removed(
    tilt_deg: float, bend_deg: float, points: int, discontinuity: bool
) -> None:
    right = rms(surface(0, 0, points, discontinuity=discontinuity))
    made = surface(tilt_deg, bend_deg, points, discontinuity=discontinuity)
    assert rms(made) < 1.5 * right + 0.01
    (notice,) = [one for one in made.warnings if one.code == "prior-drift"]
    turned = np.hypot(tilt_deg, bend_deg / np.sqrt(3))
    assert float(notice.text.partition("turned by ")[2].split()[0]) == pytest.approx(
        turned, rel=0.1
    )


def test_right_normals_do_not_drift() -> None:
    assert "prior-drift" not in [notice.code for notice in surface(0, 0, 3).warnings]


def test_errors_of_heights_follow_the_correction() -> None:
    options = {"sigma_deg": np.full((SIDE, SIDE), 1.2, np.float32), "common_sigma_deg": 1.0}
    made = surface(1.0, 0.0, 3, height_errors=True, discontinuity=False, **options)
    assert made.uncertainty is not None
    stated = float(np.sqrt(np.nanmean(made.uncertainty.sigma**2)))
    # A tilt by the stated degree alone would be 0.8 px.
    assert rms(made) < 2 * stated < 0.2


@cases(
    ("off", "terms"),
    {
        "mean": (lambda x, y: 0 * x + 3, 0),
        "plane": (lambda x, y: 2 * x - y, 2),
        "bowl": (lambda x, y: x * x + y * y, 5),
        "step": (lambda x, y: np.sign(x), 0),
        "noise": (lambda x, y: 0 * x, 0),
        "step far away": (lambda x, y: np.where(np.abs(x) > 0.4, np.sign(x), np.nan), 0),
    },
)
def test_the_order_is_that_of_the_differences(off: object, terms: int) -> None:
    rng = np.random.default_rng(1)
    values: Float64 = np.full((40, 60), np.nan)
    rows, columns = rng.integers(0, 40, 25), rng.integers(0, 60, 25)
    values[rows, columns] = off(columns / 30 - 1, rows / 20 - 1)  # type: ignore[operator]
    values += rng.normal(0, 0.01, values.shape)
    weights = np.ones(values.shape, np.float32)
    found = Drift.found(values, weights, np.zeros(values.shape, np.int32))
    assert (0 if found is None else found.terms) == terms
