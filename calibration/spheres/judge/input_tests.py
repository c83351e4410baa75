"""Tests of the given radius, distance, focal length and distortion against the images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from acquisition import CameraModel, DataError
from calibration.spheres.geometry.cone import fit_cone
from calibration.spheres.solve.joint_refinement import (
    Observation,
    Refined,
    predicted_highlights,
    slopes_at,
    weights_of,
)
from rig import Notice, short_repr
from rig.arrays import Float64

# A value is doubted if it deviates by more than this: 0.1 % of correct values do.
_SIGMAS = 3.3
# How well spheres rest on the working plane: common height and height of each, relative to the
# distance, and slope in radians.
_HEIGHT_SHARE = 1e-3
_EACH_SHARE = 5e-4
_SLOPE = np.radians(0.5)
_STEP = 1e-4
# Difference of chi-square up to which two explanations count as equally good.
_EQUAL = 9.0
RATIO, FOCAL, DISTORTION = "ratio", "focal", "distortion"
_CODES: Final = {
    RATIO: "ratio-contradicted",
    FOCAL: "focal-length-contradicted",
    DISTORTION: "distortion-contradicted",
}
# Error that all positions of a rig file have in common, as a share: a dome has its nominal radius
# to about 1 mm, and a tape measures to the lens of an LED, not to its chip.
_COMMON_SHARE = 3e-3
# Fewer places do not determine their own scatter.
_FEWEST = 4
# A larger scatter, relative to the distances from the middle, means another order or another rig.
_LARGEST_SCATTER = 0.1


@dataclass(frozen=True)
class InputTest:
    """The change of a given value that explains the data best.

    Parameters
    ----------
    name
        ``ratio`` (of radius to working distance), ``focal`` or ``distortion``.
    change
        Relative change of the given value; of the distortion, the change of k1.
    sigma
        Standard deviation of the change.
    lights_mm
        ``(N, 3)`` positions of the lights after the change; for the ratio, with another radius.
    """

    name: str
    change: float
    sigma: float
    lights_mm: Float64

    __repr__ = short_repr

    @property
    def sigmas(self) -> float:
        """Absolute change in standard deviations."""
        return abs(self.change) / self.sigma


def check_inputs(
    seen: Observation, outlines_px: list[Float64], refined: Refined
) -> list[InputTest]:
    """Estimate how the given values would have to change, each one alone.

    To the least squares of `refine`, the heights of the spheres are added: they rest on the working
    plane, to 0.1 % of the working distance, 0.05 % each, and half a degree of slope. Each value is
    added as one more unknown, and one step of Gauss-Newton from the refined lights gives its change
    (Rao's score test).

    Parameters
    ----------
    seen
        Highlights and spheres.
    outlines_px
        K arrays ``(M, 2)`` of outline points.
    refined
        Result of `refine`.

    Returns
    -------
    list of InputTest
        The changes of ratio, focal length and distortion, most significant first.
    """
    camera, sigma_px, radii = seen.camera, seen.sigma_px, seen.spheres.radii_mm
    centres = refined.centres_mm
    slopes = slopes_at(seen, refined.positions_mm, centres)
    system = slopes.weighted(sigma_px)
    count = len(centres)
    up = np.kron(np.eye(count), [[0.0, 0.0, 1.0]])
    height = centres[:, 2] - radii
    distance = camera.centre_mm[2]
    spread = (_HEIGHT_SHARE * distance) ** 2 * np.ones((count, count))
    spread += _SLOPE**2 * (centres[:, :2] @ centres[:, :2].T)
    spread += (_EACH_SHARE * distance) ** 2 * np.eye(count)
    of_height = np.linalg.inv(spread)
    system = replace(
        system,
        of_centre=system.of_centre + up.T @ of_height @ up,
        pull_centre=system.pull_centre + up.T @ of_height @ height,
        square=system.square + float(height @ of_height @ height),
    )
    freedom = max(2 * int(np.isfinite(sigma_px).sum()) - refined.positions_mm.size + count - 1, 1)
    information, off = slopes.of_outlines, slopes.off
    use, weight = np.isfinite(sigma_px)[..., None], weights_of(sigma_px)
    move_light, _ = system.steps()
    tests = []
    for name in (RATIO, FOCAL, DISTORTION):
        other, size = _changed(camera, name)
        grown = radii * (1 + size) if name == RATIO else radii
        slope = np.where(use, _predict(other, refined, grown) - _predict(camera, refined, radii), 0)
        slope = slope / size
        moved = (_placed(other, grown, outlines_px) - _placed(camera, radii, outlines_px)) / size
        by_height = -(grown - radii) / size
        of_value = np.sum(weight * slope**2) + moved @ information @ moved
        of_value += by_height @ of_height @ by_height
        pull = np.sum(weight * slope * slopes.error) - moved @ information @ off
        pull += by_height @ of_height @ height
        by_light = np.einsum("nkia,nki->na", system.by_light, weight * slope)
        by_centre = np.einsum("nkia,nki->ka", system.by_centre, weight * slope).ravel()
        by_centre += -information @ moved + up.T @ of_height @ by_height
        left, right = system.solve(by_light, by_centre)
        left_over = of_value - np.sum(by_light * left) - by_centre @ right
        pull -= np.sum(left * system.pull_light) + right @ system.pull_centre
        change = -float(pull / left_over)
        # All unknowns, the lights among them, move with the value.
        lights = refined.positions_mm + move_light - change * left
        remaining = (system.square_at_minimum() - pull**2 / left_over) / freedom
        sigma = float(np.sqrt(max(remaining, 1.0) / left_over))
        tests.append(InputTest(name, change, sigma, lights))
    return sorted(tests, key=lambda test: -test.sigmas)


def doubtful(tests: list[InputTest]) -> list[InputTest]:
    """Return the tests that explain the data best, or nearly as well; none if no value is doubted.

    Parameters
    ----------
    tests
        Result of `check_inputs`.
    """
    best = tests[0].sigmas
    if best <= _SIGMAS:
        return []
    return [test for test in tests if test.sigmas**2 > max(best**2 - _EQUAL, _SIGMAS**2)]


def doubts(
    tests: list[InputTest], camera: CameraModel, radii_mm: Float64, places_mm: Float64 | None = None
) -> tuple[list[Notice], list[Float64]]:
    """Return a warning about the value whose change explains the data best, if one is doubtful.

    Changes that explain the data nearly as well are named as well, unless the known places of the
    lights exclude them: radius and distance differ only in the scale of the whole. The lights after
    each change are the other result.

    Parameters
    ----------
    tests
        Result of `check_inputs`.
    camera
        Camera with a working distance.
    radii_mm
        ``(K,)`` radii of the spheres.
    places_mm
        ``(N, 3)`` places of the lights that are known independently; NaN where they are not.
    """
    equal = doubtful(tests)
    if not equal:
        return [], []
    explanations = [one for test in equal for one in _explanations(test, camera, radii_mm)]
    factors = [None if places_mm is None else factor_of(one[1], places_mm) for one in explanations]
    squares = [0.0 if factor is None else factor.chi_square for factor in factors]
    # If the places agree with no explanation, they do not choose one.
    least = min(squares)
    limit = least + _EQUAL if least <= _SIGMAS**2 else np.inf
    out = [square > limit for square in squares]
    kept = [one for one, without in zip(explanations, out, strict=True) if not without]
    text = (
        "highlights, outlines and the working plane contradict the given values: "
        f"{', or '.join(text for text, _ in kept)}"
    )
    if any(test.name == RATIO for test in equal):
        text += "; unless the spheres do not rest on the working plane"
    if any(factor is not None for factor in factors):
        text += _by_places([one[0] for one in explanations], factors, out, least)
    return [Notice(_CODES[equal[0].name], text)], [lights for _, lights in kept]


def _by_places(
    texts: list[str], factors: list[Factor | None], out: list[bool], least: float
) -> str:
    """Return what the known places of the lights say about explanations."""
    if least > _SIGMAS**2:
        return "; none of this agrees with led_positions_mm"
    without = [
        f"{text.partition(' (')[0]} (lights {100 * (factor.factor - 1):+.2f} +- "
        f"{100 * factor.sigma:.2f} % farther apart)"
        for text, factor, excluded in zip(texts, factors, out, strict=True)
        if excluded and factor is not None
    ]
    if without:
        return f"; led_positions_mm exclude {', and '.join(without)}"
    return "; led_positions_mm do not decide between them" if len(texts) > 1 else ""


def _explanations(
    test: InputTest, camera: CameraModel, radii_mm: Float64
) -> list[tuple[str, Float64]]:
    """Return the changes of given values that a test stands for, each with the lights after it."""
    if test.name == FOCAL:
        focal_px, change, sigma = camera.focal_px, test.change, test.sigma
        text = f"focal length {focal_px * (1 + change):.1f} +- {focal_px * sigma:.1f} px"
        return [(text, test.lights_mm)]
    if test.name == DISTORTION:
        text = f"distortion k1 changed by {test.change:+.3f} +- {test.sigma:.3f}"
        return [(text, test.lights_mm)]
    radius = f"radius {radii_mm[0] * (1 + test.change):.2f} mm"
    if np.ptp(radii_mm) > 0:
        radius = f"all radii times {1 + test.change:.4f}"
    # Images do not show the scale: another distance makes everything smaller by the same factor.
    smaller = 1 / (1 + test.change)
    sigma = 100 * test.sigma
    return [
        (f"{radius} ({100 * test.change:+.2f} +- {sigma:.2f} %)", test.lights_mm),
        (
            f"working distance {camera.centre_mm[2] * smaller:.1f} mm "
            f"({100 * (smaller - 1):+.2f} +- {sigma:.2f} %)",
            test.lights_mm * smaller,
        ),
    ]


def _changed(camera: CameraModel, name: str) -> tuple[CameraModel, float]:
    """Return a camera with one value changed, and the size of the change."""
    if name == FOCAL:
        # Only the focal lengths: the principal point keeps its place.
        K = camera.K.copy()
        K[:2, :2] *= 1 + _STEP
        return replace(camera, K=K), _STEP
    if name == DISTORTION:
        step = 10 * _STEP
        distortion = np.zeros(max(len(camera.distortion), 5))
        distortion[: len(camera.distortion)] = camera.distortion
        distortion[0] += step
        return replace(camera, distortion=distortion), step
    return camera, _STEP


def _predict(camera: CameraModel, refined: Refined, radii: Float64) -> Float64:
    return predicted_highlights(camera, refined.centres_mm, radii, refined.positions_mm)


def _placed(camera: CameraModel, radii: Float64, outlines_px: list[Float64]) -> Float64:
    """Return the centres ``(3 K,)`` that follow from outlines and radii."""
    cones = [fit_cone(camera.rays(points), 1 / camera.focal_px)[0] for points in outlines_px]
    centres = [
        camera.centre_mm + radius / cone.sine * cone.axis
        for cone, radius in zip(cones, radii, strict=True)
    ]
    return np.concatenate(centres)


@dataclass(frozen=True)
class Factor:
    """How many times as far apart lights are as the known places, with its standard deviation."""

    factor: float
    sigma: float

    __repr__ = short_repr

    @property
    def chi_square(self) -> float:
        """Deviation from 1 in standard deviations, squared."""
        return float((np.log(self.factor) / self.sigma) ** 2)


def known_places(
    led_positions_mm: Mapping[str, Sequence[float]] | None, names: tuple[str, ...]
) -> Float64:
    """Return the known places ``(N, 3)`` of lights; NaN where a place is not known.

    Raises
    ------
    DataError
        If a place is not three finite numbers.
    """
    places = np.full((len(names), 3), np.nan)
    for name, place in (led_positions_mm or {}).items():
        point: Float64 = np.asarray(place, np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise DataError(f"the position of LED {name} must be 3 finite numbers in mm")
        if name in names:
            places[names.index(name)] = point
    return places


def factor_of(lights_mm: Float64, places_mm: Float64) -> Factor | None:
    """Return how many times as far apart lights are as their known places.

    The places may be rotated and shifted as a whole. Their scatter about the lights is estimated
    from the residuals (Umeyama, Least-squares estimation of transformation parameters between two
    point patterns, 1991), so that places from a drawing decide more than places from a tape
    measure.

    Parameters
    ----------
    lights_mm
        ``(N, 3)`` positions.
    places_mm
        ``(N, 3)``; NaN where a place is not known.

    Returns
    -------
    Factor or None
        None if fewer than 4 places are known, or if their scatter exceeds a tenth of the size of
        the set: they are those of another rig, or in another order.
    """
    known = np.isfinite(places_mm).all(axis=1)
    count = int(known.sum())
    if count < _FEWEST:
        return None
    lights = lights_mm[known] - lights_mm[known].mean(axis=0)
    places = places_mm[known] - places_mm[known].mean(axis=0)
    size = float(np.sum(lights**2))
    left, values, right = np.linalg.svd(places.T @ lights)
    # A rotation, no reflection.
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    scale = float(values @ sign) / max(size, 1e-30)
    off = places - scale * lights @ (left * sign @ right).T
    scatter = float(np.sum(off**2)) / (3 * count - 7)
    if not scatter < _LARGEST_SCATTER**2 * float(np.sum(places**2)) / (3 * count):
        return None
    sigma = np.sqrt(scatter / size) / scale
    return Factor(1 / scale, float(np.hypot(sigma, _COMMON_SHARE)))
