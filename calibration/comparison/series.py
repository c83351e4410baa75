"""Drift of lights over a series of calibrations: control charts of all lights together.

The charts are those of Shewhart for single values (Montgomery, Introduction to statistical quality
control), with the centre at the median and limits from moving ranges. For short series of many
lights, three things differ:

- The scatter between calibrations is pooled over all lights: it is the variance that, added to the
  stated ones, gives the moving ranges their expected median. The few ranges of a single light would
  not determine its scatter, and a light that drifts would widen its own limits.
- Limits of 3 sigma would alarm in most stable series of 36 lights. These have the probability
  `FALSE_ALARM` for all values of a series together (Bonferroni).
- They take into account from how few moving ranges the scatter is (F distribution).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import chdtri, fdtri

from acquisition import DataError, Lights
from acquisition.values import tangent_basis
from calibration.comparison.compare import compare_lights, matched_lights, motion_text
from calibration.comparison.order import STILL, Fit, Motion, fit_motion
from rig import Notice, listed, pluralize, short_repr
from rig.arrays import Bool, Float64, Intp

# Probability that any value of a stable series is beyond its limit.
FALSE_ALARM: Final = 0.02
# Directions, strengths and the common motion share it.
_FAMILIES: Final = 3
_FEWEST: Final = 3
# With fewer lights, a common motion is not separated from motions of single ones.
_FEWEST_LIGHTS: Final = 5
# With fewer calibrations, the notice `series-short` says what is not known.
_SHORT: Final = 6
# A scatter of so many times the stated one is named; errors that lights share explain less.
_SCATTERED: Final = 3.0
# Share of the information of a sample that its median of absolute values keeps.
_EFFICIENCY: Final = 0.37
# Radians, relative strengths and mm; smaller scatter does not count.
_FLOOR: Final = 2e-6
_FLOOR_MM: Final = 1e-3
_SINGULAR: Final = 1e-9
_ORDER: Final = ("lights-reversed", "lights-flipped", "lights-swapped")
_OF_PAIRS: Final = ("lights-matched-by-order", "setups-differ")
_NAMED: Final = 6


@dataclass(frozen=True, eq=False)
class LightDrift:
    """Deviations of K calibrations of the same N lights from the centre of their series.

    Parameters
    ----------
    ids
        Names of the lights.
    common_deg
        ``(K,)`` median angle by which the motion that all lights have in common turns them.
    common_ratio
        ``(K,)`` this motion in units of its limit; NaN with fewer than 5 lights.
    common_limit_deg
        Rotation of all lights that reaches the limit, about the axis that is known least.
    offsets_deg
        ``(K, N, 2)`` deviation of each direction from the origin without the common motion, in the
        tangent basis (`acquisition.values.tangent_basis`) of its centre.
    direction_limit_deg
        ``(K, N)`` limits for their lengths.
    strength_percent, strength_limit_percent
        ``(K, N)`` deviations of the strengths without the factor that all lights have in common, of
        which the median light is at 0, and limits for their sizes. NaN where the strengths
        of a calibration were not measured.
    warnings
        What is beyond a limit, the common motion first, and what a short series does not show.
    """

    ids: tuple[str, ...]
    common_deg: Float64
    common_ratio: Float64
    common_limit_deg: float
    offsets_deg: Float64
    direction_limit_deg: Float64
    strength_percent: Float64
    strength_limit_percent: Float64
    warnings: tuple[Notice, ...]

    __repr__ = short_repr

    @property
    def direction_ratio(self) -> Float64:
        """``(K, N)`` deviations of the directions in units of their limits."""
        return np.asarray(np.linalg.norm(self.offsets_deg, axis=2) / self.direction_limit_deg)

    @property
    def strength_ratio(self) -> Float64:
        """``(K, N)`` deviations of the strengths in units of their limits, with their signs."""
        return self.strength_percent / self.strength_limit_percent

    @property
    def ratio(self) -> Float64:
        """``(K, N)`` the larger of both, without signs."""
        return np.asarray(np.fmax(self.direction_ratio, np.abs(self.strength_ratio)))

    @property
    def beyond(self) -> Bool:
        """``(N,)`` lights whose direction or strength is beyond a limit in a calibration."""
        return np.asarray(self.ratio.max(axis=0) > 1)

    @property
    def worst_first(self) -> Intp:
        """Indices of the lights, those that are furthest beyond a limit first."""
        return np.argsort(-self.ratio.max(axis=0), kind="stable")

    @property
    def moved(self) -> bool:
        """Whether the motion that all lights have in common is beyond its limit."""
        return bool((self.common_ratio > 1).any())


def order_by_date(calibrations: Sequence[Lights], names: Sequence[str]) -> tuple[list[int], bool]:
    """Return the order of calibrations in time, and whether it is that of their dates.

    Without a date, it is the order in which they are given.

    Raises
    ------
    DataError
        If two have the same date, or, with one that has no date, those of the others descend.

    Examples
    --------
    >>> from acquisition import Lights
    >>> from calibration.comparison import order_by_date
    >>> order_by_date([Lights(directions=[[0, 0, 1.0]])] * 2, ["a.json", "b.json"])
    ([0, 1], False)
    """
    times = [None if one.calibrated is None else one.calibrated.time_utc for one in calibrations]
    dated = sorted((time, n) for n, time in enumerate(times) if time is not None)
    for (time, n), (later, other) in itertools.pairwise(dated):
        if time == later:
            raise DataError(
                f"{names[n]} and {names[other]} state the same date, {time:%Y-%m-%d %H:%M:%S}: "
                "give each calibration once"
            )
        if len(dated) < len(times) and n > other:
            undated = names[times.index(None)]
            raise DataError(
                f"{names[n]} is older than {names[other]}, which is given first, and {undated} "
                "has no date: give all in the order of time"
            )
    if len(dated) < len(times):
        return list(range(len(times))), False
    return [n for _, n in dated], True


def light_drift(
    calibrations: Sequence[Lights],
    names: Sequence[str] = (),
    *,
    least_deg: float = 0.0,
    least_percent: float = 0.0,
) -> LightDrift:
    """Find the lights that drift in a series of calibrations, and motions of all of them.

    Parameters
    ----------
    calibrations
        Three or more calibrations of the same lights in the order of time. Lights are matched by
        their ids; those that a calibration left out are not compared, as in `compare_lights`.
    names
        Names of the calibrations in messages; default: their numbers.
    least_deg, least_percent
        Deviations up to these are allowed, also beyond a control limit.

    Raises
    ------
    DataError
        If there are fewer than three, they cannot be compared, two are equal, or lights of one are
        at the places of others.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from calibration.comparison import light_drift
    >>> rng = np.random.default_rng(0)
    >>> series = [rng.normal([0, 0, 450], [200, 200, 0], (12, 3))] * 8
    >>> series = [Lights(positions_mm=one + rng.normal(0, 0.2, (12, 3))) for one in series]
    >>> light_drift(series).beyond.any()
    np.False_
    """
    names = tuple(names) or tuple(f"calibration {n}" for n in range(1, len(calibrations) + 1))
    if len(calibrations) < _FEWEST:
        raise DataError(f"a series needs {_FEWEST} calibrations or more")
    series, matching = _matched(calibrations, names)
    ids, near, level = series[0].ids, series[0].near, FALSE_ALARM / _FAMILIES / len(series)
    vectors = np.array([one.positions_mm if near else one.unit_directions for one in series])
    centre = np.median(vectors, axis=0)
    unknown = np.full(len(series), np.nan)
    common = _Common(STILL, unknown, unknown, float("nan"), "")
    if len(ids) >= _FEWEST_LIGHTS:
        for _ in range(2):  # the second time, the centre is not blurred by common motions
            fits = [_fit(centre, one, near) for one in vectors]
            aligned = [_undone(fit, one) for fit, one in zip(fits, vectors, strict=True)]
            centre = np.median(aligned, axis=0)
        common = _common(centre, fits, level, near, names)
        vectors = np.array(aligned)
    towards = _unit(centre)
    offsets = np.einsum("nij,knj->kni", tangent_basis(towards), _unit(vectors))
    sigmas = np.array([_direction_sigmas(one) for one in series])
    direction_limits = _limits(offsets, sigmas, level)
    scatter = float(np.median(direction_limits / _limits(0 * offsets, sigmas, level)))
    # A common motion takes its share of the scatter of few lights.
    fitted, numbers = (6, 3 * len(ids)) if near else (3, 2 * len(ids))
    if len(ids) >= _FEWEST_LIGHTS:
        direction_limits *= np.sqrt(numbers / (numbers - fitted))
    strengths, strength_sigmas = _strengths(series)
    strength_limits = _limits(strengths[..., None], strength_sigmas, level)
    drift = LightDrift(
        ids,
        common.turns_deg,
        np.where(common.turns_deg <= least_deg, 0, common.ratio),
        common.limit_deg,
        np.degrees(offsets),
        np.fmax(np.degrees(direction_limits), least_deg),
        100 * np.expm1(strengths),
        np.fmax(100 * strength_limits, least_percent),
        (),
    )
    if drift.moved or drift.beyond.any():
        _check_order(series, names)
    notices = _notices(drift, names, common, scatter if sigmas.all() else 0.0)
    return replace(drift, warnings=(*matching, *notices))


def _matched(
    calibrations: Sequence[Lights], names: Sequence[str]
) -> tuple[list[Lights], list[Notice]]:
    """Return the lights that all have, in the order of the first one, and notices about others."""
    first = calibrations[0]
    for n, other in enumerate(calibrations[1:], 1):
        if other.near != first.near:
            kinds = ["positions" if one.near else "directions" for one in (first, other)]
            raise DataError(f"{names[0]} has {kinds[0]}, {names[n]} {kinds[1]}: give one kind")
        try:
            first = matched_lights(first, other)[0]
        except DataError as error:
            raise DataError(f"{names[0]} and {names[n]}: {error}") from error
    pairs = [matched_lights(first, one)[1:] for one in calibrations]
    series = [one for one, _ in pairs]
    for (k, one), (n, other) in itertools.combinations(enumerate(series), 2):
        same = np.array_equal(one.unit_directions, other.unit_directions)
        if same and np.array_equal(np.asarray(one.intensities), np.asarray(other.intensities)):
            raise DataError(
                f"{names[k]} and {names[n]} have the same lights: give each calibration once"
            )
    both = zip(calibrations, series, strict=True)
    left = list(dict.fromkeys(name for of, kept in both for name in of.ids if name not in kept.ids))
    text = f"not all calibrations have {listed(left, _NAMED)}: not compared"
    notices = [Notice("lights-not-compared", text)] if left else []
    named = [(name, one) for name, (_, found) in zip(names, pairs, strict=True) for one in found]
    return series, notices + [replace(o, where=name) for name, o in named if o.code in _OF_PAIRS]


def _check_order(series: Sequence[Lights], names: Sequence[str]) -> None:
    """Refuse a series in which lights are at the places of others."""
    for name, other in zip(names[1:], series[1:], strict=True):
        for notice in compare_lights(series[0], other).warnings:
            if notice.code in _ORDER:
                raise DataError(f"{name} has another order than {names[0]}: {notice.text}")


def _unit(vectors: Float64) -> Float64:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _fit(centre: Float64, vectors: Float64, near: bool) -> Fit:
    if near:
        return fit_motion(centre, vectors, "both", freedom=3, floor=_FLOOR_MM)
    return fit_motion(centre, vectors, "turn", freedom=2, floor=_FLOOR)


def _undone(fit: Fit, vectors: Float64) -> Float64:
    """Return vectors before a motion."""
    return (vectors - fit.motion.shift_mm) @ fit.motion.rotation


class _Common(NamedTuple):
    """Common motions relative to that in the middle: the largest one, and figures of all."""

    largest: Motion
    turns_deg: Float64
    ratio: Float64
    limit_deg: float
    place: str


def _common(
    centre: Float64, fits: list[Fit], level: float, near: bool, names: Sequence[str]
) -> _Common:
    """Compare the common motions with their scatter."""
    motions = [fit.motion for fit in fits]
    values = np.array([np.radians(one.angle_deg) * one.axis for one in motions])
    x, y, z = centre.T
    zero = np.zeros_like(x)
    effect = np.array([[zero, z, -y], [-z, zero, x], [y, -x, zero]]).transpose(2, 0, 1)
    if near:
        values = np.hstack([values, [one.shift_mm for one in motions]])
        effect = np.concatenate([effect, np.tile(np.eye(3), (len(centre), 1, 1))], axis=2)
    away = values - np.median(values, axis=0)
    scale = float(np.median([fit.scale for fit in fits]))
    information = np.einsum("nia,nib->ab", effect, effect) / scale**2
    # A turn about a line through all lights has no effect.
    information += _SINGULAR * np.diag(np.diag(information))
    # Without scatter between calibrations, whitened values have the variance 1.
    white = away @ np.linalg.cholesky(information)
    ranges, parts = np.diff(white, axis=0), white.shape[1]
    # The median of absolute values of a normal distribution is 0.6745 sigma; a range has two.
    scatter = max(1.0, float(np.median(np.abs(ranges))) / (0.6745 * np.sqrt(2)))
    limit = scatter * np.sqrt(parts * fdtri(parts, _EFFICIENCY * ranges.size, 1 - level))
    ratio = np.linalg.norm(white, axis=1) / limit
    across = np.cross(_unit(centre), np.einsum("nia,ka->kni", effect, away))
    turns = np.linalg.norm(across, axis=2) / np.linalg.norm(centre, axis=1)
    least = float(np.linalg.eigvalsh(information[:3, :3])[0])
    farthest = int(np.argmax(ratio))
    turn = Rotation.from_rotvec(away[farthest, :3]).as_matrix()
    return _Common(
        Motion(turn, away[farthest, 3:] if near else np.zeros(3)),
        np.degrees(np.median(turns, axis=1)),
        ratio,
        float(np.degrees(limit / np.sqrt(least))),
        f"in {names[farthest]}, compared with the middle of the series, most {_jump(white, names)}",
    )


def _limits(values: Float64, sigmas: Float64, level: float) -> Float64:
    """Return limits ``(K, N)`` for the lengths of the deviations ``(K, N, d)`` from a median."""
    known = np.isfinite(values).all(axis=(1, 2))
    limits = np.full(sigmas.shape, np.nan)
    number, parts = int(known.sum()), values.shape[2]
    if number < _FEWEST:
        return limits
    squares = np.sum(np.diff(values[known], axis=0) ** 2, axis=2)
    stated = sigmas[known][1:] ** 2 + sigmas[known][:-1] ** 2
    expected = float(chdtri(parts, 0.5))

    def excess(variance: float) -> float:
        return float(np.median(squares / (stated + 2 * variance))) - expected

    least, most = _FLOOR**2, 2 * float(squares.max()) + _FLOOR
    added = brentq(excess, least, most) if excess(least) > 0 else least
    variances = sigmas[known] ** 2 + added
    # That of a median of n values is pi / 2n of theirs.
    variances += np.pi / 2 / number * variances.mean(axis=0)
    freedom = _EFFICIENCY * parts * squares.size
    factor = parts * fdtri(parts, freedom, 1 - level / squares.shape[1])
    limits[known] = np.sqrt(factor * variances)
    return limits


def _direction_sigmas(lights: Lights) -> Float64:
    """Return the largest standard deviation of each direction, 0 if it is not known."""
    errors = lights.distant().errors
    if errors is None or errors.covariances is None:
        return np.zeros(len(lights))
    values = np.linalg.eigvalsh(np.nan_to_num(errors.covariances))
    return np.asarray(np.sqrt(values[:, -1].clip(0)))


def _strengths(series: Sequence[Lights]) -> tuple[Float64, Float64]:
    """Return deviations ``(K, N)`` of the logarithms of strengths, and what is stated of them."""
    strengths = np.array([np.asarray(one.intensities) for one in series])
    logs, sigmas = np.log(strengths).mean(axis=2), np.zeros(strengths.shape[:2])
    for row, one, strength in zip(sigmas, series, strengths, strict=True):
        if one.errors is not None and one.errors.intensity_std is not None:
            row[:] = np.nan_to_num(one.errors.intensity_std / strength).mean(axis=1)
    measured = np.ptp(strengths, axis=(1, 2)) > 0
    if measured.sum() < _FEWEST:
        return np.full_like(logs, np.nan), sigmas
    for _ in range(2):  # the second time, the centre is not blurred by common factors
        logs -= np.median(logs - np.median(logs[measured], axis=0), axis=1, keepdims=True)
    logs -= np.median(logs[measured], axis=0)
    logs[~measured] = np.nan
    return logs, sigmas


def _jump(values: Float64, names: Sequence[str]) -> str:
    """Return between which calibrations values ``(K, d)`` changed most."""
    largest = int(np.argmax(np.linalg.norm(np.diff(values, axis=0), axis=1)))
    return f"between {names[largest]} and {names[largest + 1]}"


def _notices(
    drift: LightDrift, names: Sequence[str], common: _Common, scatter: float
) -> Iterator[Notice]:
    count, number = int(drift.beyond.sum()), len(drift.ids)
    if drift.moved:
        text = (
            f"all lights {motion_text(common.largest)} {common.place}: the camera, the board or "
            "the plane of the object moved: calibrate all lights again"
        )
        yield Notice("lights-moved-together", text)
    if count:
        said = listed([_of_light(drift, n, names) for n in drift.worst_first[:count]], _NAMED)
        which = "all lights" if count > number / 2 else "it" if count == 1 else "them"
        yield Notice(
            "lights-drifted",
            f"{pluralize(count, 'light')} of {number} {'is' if count == 1 else 'are'} beyond the "
            f"limits: {said}: calibrate {which} again",
        )
    if scatter > _SCATTERED:
        text = (
            f"the directions scatter {scatter:.0f} times as much as the calibrations state, and so "
            "do the limits: compare the spheres, cameras and working planes"
        )
        yield Notice("series-scattered", text)
    if len(names) < _SHORT:
        text = f"{len(names)} calibrations do not distinguish a change that continues from scatter"
        if np.isfinite(drift.common_limit_deg):
            text += f"; a turn of all lights is found from {drift.common_limit_deg:.2g} deg on"
        yield Notice("series-short", text, "", "info")


def _of_light(drift: LightDrift, n: int, names: Sequence[str]) -> str:
    said = []
    if drift.direction_ratio[:, n].max() > 1:
        size = np.linalg.norm(drift.offsets_deg[:, n], axis=1).max()
        said.append(f"turned by {size:.2g} deg, most {_jump(drift.offsets_deg[:, n], names)}")
    if (np.abs(drift.strength_ratio[:, n]) > 1).any():
        known = np.isfinite(drift.strength_percent[:, n]).nonzero()[0][[0, -1]]
        ends = [f"{drift.strength_percent[k, n]:+.1f} % in {names[k]}" for k in known]
        said.append(f"strength {', '.join(ends)}")
    return f"{drift.ids[n]} ({'; '.join(said)})"
