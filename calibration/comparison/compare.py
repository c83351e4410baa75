"""Comparison of two calibrations of the same lights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from acquisition import DataError, LightErrors, Lights, angle_deg
from acquisition.source import setup_differences
from acquisition.value_files import lights_of_rig
from acquisition.values import led_of, tangent_basis
from calibration.comparison.order import Explanation, Mirror, Motion, explain
from rig import Notice, RigConfig, check_type, figure, listed, pluralize, short_repr
from rig.arrays import Float64, Intp

# Differences below a micrometre, or the angle that it spans at half a metre, do not count.
_FLOOR_MM, _FLOOR_RAD = 1e-3, 2e-6
# Differences that change normals equally, see `LightComparison.worst_first`.
_EQUAL_MM, _EQUAL_DEG, _EQUAL_PERCENT = 3.0, 0.35, 1.0
# Probability of naming a light although all covariances are right.
_FALSE_ALARM = 1e-3
_NAMED = 6
# Eigenvalues of a covariance below this share of the largest one count as zero.
_SINGULAR = 1e-9
# Spheres up to 150 mm from the origin see a light at 450 mm in directions that differ by this.
_PARALLAX_DEG = 20.0
_MISSING_NAMED = 8
_REMEDY = "check the order of wires, images or led_positions_mm"
# A shift or a rotation below these is not worth a word.
_LEAST_MM, _LEAST_DEG = 5e-4, 5e-4
_LEAST_NAMED = 1e-3
_SIDES = {"x": "left and right", "y": "top and bottom"}


@dataclass(frozen=True, eq=False)
class LightComparison:
    """Differences of a calibration B from a calibration A of the same N lights.

    Parameters
    ----------
    ids
        Names in A of the lights that both have.
    angle_deg
        ``(N,)`` angles between the directions from the origin toward a light of A and of B.
    distance_mm
        ``(N,)`` distances between the positions; None for directions.
    intensity_factor
        Factor between all intensities of B and of A, the median of their ratios over lights and
        channels. Intensities are relative, so it is no difference. NaN unless both have
        intensities: those that were not measured are all equal.
    intensity_percent
        ``(N,)`` differences of the intensities of B after removing the factor, relative to A, of
        the channel that differs most; NaN unless both have intensities.
    deviations
        ``(N,)`` differences of position or direction in combined standard deviations:
        ``sqrt(d^T C^-1 d)`` with the sum C of both covariances. NaN where one of them is not
        known, infinite where C excludes the difference.
    intensity_deviations
        ``(N,)`` the same for the intensities.
    mirror
        ``x`` if B has left and right exchanged, ``y`` for top and bottom, else empty.
    is_reversed
        Whether B has the lights in the reverse order.
    exchanged
        Cycles of lights at the places of one another: ``(("L07", "L08"),)`` if these are swapped.
        In a longer cycle each light of B is at the place of the next one.
    motion
        Rotation and shift that all lights have in common; None if there is no such motion, or
        if it leaves more than half of the differences.
    rest_deg, rest_mm
        ``(N,)`` angles and distances that remain after all of these.
    warnings
        One notice for each of these, and one for lights that differ by more than their errors
        explain.
    """

    ids: tuple[str, ...]
    angle_deg: Float64
    distance_mm: Float64 | None
    intensity_factor: float
    intensity_percent: Float64
    deviations: Float64
    intensity_deviations: Float64
    mirror: Mirror
    is_reversed: bool
    exchanged: tuple[tuple[str, ...], ...]
    motion: Motion | None
    rest_deg: Float64
    rest_mm: Float64 | None
    warnings: tuple[Notice, ...]

    __repr__ = short_repr

    @property
    def same_order(self) -> bool:
        """Whether every light of B is that of A: not swapped, reversed or mirrored."""
        return not (self.mirror or self.is_reversed or self.exchanged)

    @property
    def worst_first(self) -> Intp:
        """Indices of the lights, those with the largest effect on normals first.

        3 mm of a position, 0.35 degrees of a direction and 1 % of an intensity have similar
        effects on the normals of a flat object under 36 lights.
        """
        place = self.angle_deg / _EQUAL_DEG
        if self.distance_mm is not None:
            place = self.distance_mm / _EQUAL_MM
        effect = np.fmax(place, np.abs(self.intensity_percent) / _EQUAL_PERCENT)
        return np.argsort(-effect, kind="stable")


def compare_lights(a: Lights, b: Lights) -> LightComparison:
    """Compare two calibrations of the same lights.

    Besides the differences of each light, a motion that all lights have in common is estimated (the
    camera or the board moved), and another order of the lights (swapped wires), reversed and
    mirrored calibrations are found; the shortest description of all differences is reported.

    Parameters
    ----------
    a
        The reference.
    b
        The other calibration; its lights are matched with those of ``a`` by their ids, or by order
        with a warning. Lights that one calibration left out are not compared, with a warning, if
        it states with what it was calibrated and at least half of the lights are in both.

    Returns
    -------
    LightComparison
        Differences of ``b`` from ``a``.

    Raises
    ------
    DataError
        If one of them has positions and the other directions, or the numbers or names of the lights
        differ.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from calibration import compare_lights
    >>> before = Lights(positions_mm=np.array([[300, 0, 300], [0, 300, 300], [-300, 0, 310.0]]))
    >>> after = Lights(positions_mm=np.array([[300, 0, 300], [0, 304, 303], [-300, 0, 310.0]]))
    >>> compare_lights(before, after).distance_mm.tolist()
    [0.0, 5.0, 0.0]
    """
    check_type("a", a, Lights, "acquisition.read_lights(path) returns one")
    check_type("b", b, Lights, "acquisition.read_lights(path) returns one")
    kinds = ["positions" if lights.near else "directions" for lights in (a, b)]
    if kinds[0] != kinds[1]:
        raise DataError(
            f"the first calibration has {kinds[0]}, the second {kinds[1]}: compare two of one kind"
        )
    a, b, unmatched = matched_lights(a, b)
    vectors = [
        one.unit_directions if one.positions_mm is None else one.positions_mm for one in (a, b)
    ]
    covariances = covariances_3d(a), covariances_3d(b)
    freedom, floor = (3, _FLOOR_MM) if a.near else (2, _FLOOR_RAD)
    floor = _typical(covariances, freedom, floor)
    found = explain(*vectors, freedom=freedom, floor=floor)
    moved = found.moved(vectors[0])
    difference = vectors[1] - vectors[0]
    across = None if a.near else vectors[1]
    sigmas = rest_sigmas = np.full(len(a), np.nan)
    first, second = covariances
    if first is not None and second is not None:
        sigmas = deviations(difference, first + second, across)
        rest_sigmas = deviations(vectors[1] - moved, found.carried(first) + second, across)
    factor, percent, strength_sigmas = _intensities(a, b)
    rest_deg = angle_deg(moved, vectors[1])
    rest_mm = np.linalg.norm(vectors[1] - moved, axis=1) if a.near else None
    rest, unit = (rest_deg, "deg") if rest_mm is None else (rest_mm, "mm")
    return LightComparison(
        ids=a.ids,
        angle_deg=angle_deg(*vectors),
        distance_mm=np.linalg.norm(difference, axis=1) if a.near else None,
        intensity_factor=factor,
        intensity_percent=percent,
        deviations=sigmas,
        intensity_deviations=strength_sigmas,
        mirror=found.mirror,
        is_reversed=found.is_reversed,
        exchanged=tuple(tuple(a.ids[n] for n in cycle) for cycle in found.exchanged),
        motion=None if found.kind == "none" else found.motion,
        rest_deg=rest_deg,
        rest_mm=rest_mm,
        warnings=(
            *unmatched,
            *explanation_notices(found, a.ids, rest, unit),
            *_changed(a.ids, rest_sigmas, freedom),
        ),
    )


def _typical(covariances: Sequence[Float64 | None], freedom: int, least: float) -> float:
    """Return the typical standard deviation of a difference's coordinate, at least ``least``."""
    variance = 0.0
    for known in covariances:
        if known is not None:
            variance += float(np.nanmedian(np.trace(known, axis1=1, axis2=2))) / freedom
    return max(float(np.sqrt(variance)), least)


def _intensities(a: Lights, b: Lights) -> tuple[float, Float64, Float64]:
    """Return the common factor, and the differences in percent and in standard deviations."""
    strengths = [np.asarray(lights.intensities) for lights in (a, b)]
    if not all(np.ptp(strength) for strength in strengths):
        unknown = np.full(len(a), np.nan)
        return float("nan"), unknown, unknown
    ratio = np.log(strengths[1]) - np.log(strengths[0])
    factor = float(np.median(ratio))
    ratio -= factor
    rows, worst = np.arange(len(a)), np.argmax(np.abs(ratio), axis=1)
    percent = 100 * np.expm1(ratio[rows, worst])
    variance = np.zeros_like(ratio)
    for lights, strength in zip((a, b), strengths, strict=True):
        known = None if lights.errors is None else lights.errors.intensity_std
        variance += np.nan if known is None else (known / strength) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        sigmas = np.abs(ratio) / np.sqrt(variance)
    sigmas[(ratio == 0) & np.isfinite(variance)] = 0
    return float(np.exp(factor)), percent, sigmas[rows, worst]


def _changed(ids: Sequence[str], sigmas: Float64, freedom: int) -> Iterator[Notice]:
    """Yield a notice about lights that differ by more than their errors explain."""
    known = np.isfinite(sigmas) | np.isposinf(sigmas)
    if not known.any():
        return
    limit = float(np.sqrt(chdtri(freedom, _FALSE_ALARM / np.count_nonzero(known))))
    order = [n for n in np.argsort(-np.where(known, sigmas, 0), kind="stable") if known[n]]
    beyond = [int(n) for n in order if sigmas[n] > limit]
    if not beyond:
        return
    named = listed([f"{ids[n]} ({sigmas[n]:.1f})" for n in beyond], _NAMED)
    verb = "differs" if len(beyond) == 1 else "differ"
    yield Notice(
        "lights-changed",
        f"{pluralize(len(beyond), 'light')} of {len(ids)} {verb} by more than the errors of both "
        f"calibrations explain ({limit:.1f} standard deviations): {named}",
    )


def covariances_3d(lights: Lights) -> Float64 | None:
    """Return covariances ``(N, 3, 3)`` in the house frame, of positions or of unit directions."""
    if lights.errors is None or lights.errors.covariances is None:
        return None
    if lights.near:
        return lights.errors.covariances
    basis = tangent_basis(lights.unit_directions)
    return basis.transpose(0, 2, 1) @ lights.errors.covariances @ basis


def deviations(difference: Float64, covariances: Float64, across: Float64 | None) -> Float64:
    """Return Mahalanobis distances ``(N,)`` of differences ``(N, 3)``; NaN without a covariance.

    ``sqrt(d^T C^-1 d)``: with d coordinates, its square has the mean d if the covariance is right.
    A difference that the covariance excludes is infinitely many standard deviations long.

    Parameters
    ----------
    difference, covariances
        Differences, and the sums of the covariances of both calibrations.
    across
        ``(N, 3)`` unit directions at right angles to which directions differ; None for positions.
    """
    if across is not None:
        basis = tangent_basis(across)
        difference = np.einsum("nij,nj->ni", basis, difference)
        covariances = basis @ covariances @ basis.transpose(0, 2, 1)
    found = np.full(len(difference), np.nan)
    for n, (vector, matrix) in enumerate(zip(difference, covariances, strict=True)):
        if np.isnan(matrix).any():
            continue
        values, vectors = np.linalg.eigh(matrix)
        along = vectors.T @ vector
        regular = values > _SINGULAR * float(values.max())
        excluded = np.abs(along[~regular]) > _SINGULAR * float(np.linalg.norm(vector))
        total = np.sum(along[regular] ** 2 / values[regular])
        found[n] = np.inf if excluded.any() else np.sqrt(total)
    return found


def compare_with_rig(lights: Lights, config: RigConfig) -> LightComparison:
    """Compare calibrated lights with the positions of the LEDs in a rig file.

    The positions of a rig file have the standard deviation ``led_positions_sigma_mm`` in x, y and
    z, by default that of a tape measure. A calibration without errors is exact in comparison. Of
    directions only the order is judged, and rotations of the whole by more than 20 degrees: they
    were measured at the spheres, not at the origin.

    Parameters
    ----------
    lights
        Lights with the ids of LEDs (``L07``), positions or directions; not all LEDs are required.
    config
        Configuration of the rig, with ``led_positions_mm``.

    Returns
    -------
    LightComparison
        Differences of the lights from the rig file. ``lights-changed`` names the lights that
        contradict it.

    Raises
    ------
    DataError
        If the rig file has no positions, or a light is not one of its LEDs.

    Examples
    --------
    >>> from acquisition import Lights
    >>> from calibration.comparison import compare_with_rig
    >>> from rig import RigConfig
    >>> places = [[300, 0, 300], [0, 310, 300], [-280, 0, 300]]
    >>> config = RigConfig(name="arc", driver="bench", leds=3, led_positions_mm=places)
    >>> compare_with_rig(Lights(positions_mm=[places[n] for n in (0, 2, 1)]), config).exchanged
    (('L01', 'L02'),)
    """
    check_type("lights", lights, Lights, "acquisition.read_lights(path) returns one")
    check_type("config", config, RigConfig, "rig.find_rig_config(name) returns one")
    stated = replace(lights_of_rig(config), calibrated=None)
    leds = []
    for name in lights.ids:
        led = led_of(name)
        if led is None or led >= config.leds:
            raise DataError(
                f"light {name} is not one of the {pluralize(config.leds, 'LED')} of the rig "
                f"{config.name}: give lights of this rig"
            )
        leds.append(led)
    if len(set(leds)) < len(leds):
        twice = next(led for led in leds if leds.count(led) > 1)
        raise DataError(f"two lights belong to LED {twice}: give lights with one id per LED")
    measured = replace(stated.take(leds), intensities=lights.intensities)
    if not lights.near:
        return _of_directions(lights, measured)
    return compare_lights(measured, replace(lights, ids=measured.ids, errors=_stated(lights)))


def _of_directions(lights: Lights, places: Lights) -> LightComparison:
    """Compare directions, which were not measured at the origin, but at the spheres.

    They may differ from those of the rig file by many degrees, in part like a common rotation.
    """
    measured = replace(places, errors=None).distant()
    compared = compare_lights(measured, replace(lights, ids=places.ids, errors=None))
    if compared.motion is None or compared.motion.angle_deg > _PARALLAX_DEG:
        return compared
    kept = (one for one in compared.warnings if one.code != "lights-moved-together")
    return replace(compared, warnings=tuple(kept))


def _stated(lights: Lights) -> LightErrors:
    """Return the errors of near lights with zero for covariances that are not known."""
    errors = lights.errors or LightErrors()
    zero = np.zeros((len(lights), 3, 3))
    known = zero if errors.covariances is None else np.nan_to_num(errors.covariances)
    return replace(errors, covariances=known)


def matched_lights(a: Lights, b: Lights) -> tuple[Lights, Lights, tuple[Notice, ...]]:
    """Return the lights that both have, in the order of ``a``, and notices about others and setups.

    A calibration may have left out lights. So if it names the frames of its lights, the other one
    may have more of them.

    Raises
    ------
    DataError
        If the numbers or names of the lights differ, and not because a calibration left out lights.
    """
    setups = tuple(_setups(a, b))
    if len(a) == len(b):
        try:
            order, by_name = b.match(a.ids)
        except DataError:
            pass
        else:
            if by_name:
                return a, b.take(order), setups
            text = (
                "lights with different names are matched by order "
                f"({b.ids[0]} to {a.ids[0]} and so on)"
            )
            return a, b, (*setups, Notice("lights-matched-by-order", text))
    places = [_place(name, b) for name in a.ids]
    both = [n for n, place in enumerate(places) if place is not None]
    order = [place for place in places if place is not None]
    only_a = [name for name, place in zip(a.ids, places, strict=True) if place is None]
    only_b = [name for n, name in enumerate(b.ids) if n not in order]
    left_out = (not only_a or b.calibrated is not None) and (not only_b or a.calibrated is not None)
    if not left_out or len(set(order)) < len(order) or 2 * len(both) < max(len(a), len(b)):
        raise _different(a, b, only_a)
    return a.take(both), b.take(order), (*setups, *_missing(only_a, only_b))


def _setups(a: Lights, b: Lights) -> Iterator[Notice]:
    """Yield a notice if two calibrations state different rigs, cameras or lenses."""
    if a.calibrated and b.calibrated:
        different = setup_differences(a.calibrated.setup, b.calibrated.setup)
        if different:
            text = f"the calibrations are not of one rig, camera and lens: {', '.join(different)}"
            yield Notice("setups-differ", text)


def _place(name: str, lights: Lights) -> int | None:
    """Return the index of the light with a name, or None."""
    try:
        (place,), by_name = lights.match([name])
    except DataError:
        return None
    return place if by_name else None


def _missing(only_a: list[str], only_b: list[str]) -> Iterator[Notice]:
    for names, other in ((only_a, "second"), (only_b, "first")):
        if names:
            text = f"the {other} calibration has no light {listed(names, _MISSING_NAMED)}"
            yield Notice("lights-not-compared", f"{text}: not compared")


def _different(a: Lights, b: Lights, only_a: list[str]) -> DataError:
    if len(a) != len(b):
        text = f"the first calibration has {pluralize(len(a), 'light')}, the second {len(b)}"
    else:
        missing = only_a[0] if only_a else a.ids[0]
        text = f"the calibrations name their lights differently: the second has no {missing}"
    return DataError(f"{text}: compare calibrations of the same lights")


def explanation_notices(
    found: Explanation, ids: Sequence[str], rest: Float64, unit: str
) -> Iterator[Notice]:
    """Yield a notice for another order, a mirror image and a common motion.

    Parameters
    ----------
    found
        The explanation.
    ids
        Names of the lights.
    rest
        ``(N,)`` what remains, in ``unit``.
    unit
        ``mm`` for positions, else ``deg``.
    """
    if found.is_reversed:
        text = (
            f"the order is reversed: {ids[0]} is at the place of {ids[len(ids) - 1]} of the other "
            f"calibration, and so on: {_REMEDY}"
        )
        yield Notice("lights-reversed", text)
    if found.mirror:
        text = (
            f"the lights are mirrored: {_SIDES[found.mirror]} are exchanged; check the mounting of "
            "the camera, the axes, and whether the LEDs are counted in the other sense"
        )
        yield Notice("lights-flipped", text)
    yield from _exchanges(found, ids)
    if found.kind != "none":
        median = float(np.median(rest))
        left = f"{figure(median) if median >= _LEAST_NAMED else f'< {_LEAST_NAMED:g}'} {unit}"
        text = (
            f"all lights {motion_text(found.motion)}: the camera, the board or the plane of the "
            f"object moved; without this motion, half of the differences are within {left}"
        )
        yield Notice("lights-moved-together", text)


def motion_text(motion: Motion) -> str:
    """Return a motion as the end of a sentence about the lights."""
    said = []
    if motion.angle_deg >= _LEAST_DEG:
        said.append(f"turned together by {motion.angle_deg:.3g} deg about {_vector(motion.axis)}")
    length = float(np.linalg.norm(motion.shift_mm))
    if length >= _LEAST_MM:
        said.append(f"shifted together by {figure(length, 3)} mm, {_vector(motion.shift_mm)}")
    return " and ".join(said) or "stayed in place"


def named(ids: Sequence[str]) -> str:
    """Return the names of lights for a sentence: ``LED 7 and 8``, or ``chrome.7 and chrome.8``."""
    leds = [led_of(name) for name in ids]
    plain = all(led is not None for led in leds)
    names = [str(led) for led in leds] if plain else list(ids)
    all_names = " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
    return f"LED {all_names}" if plain else all_names


def _exchanges(found: Explanation, ids: Sequence[str]) -> Iterator[Notice]:
    cycles = found.exchanged
    if not cycles:
        return
    moved = sum(map(len, cycles))
    if moved > len(ids) / 2:
        first, place = (named([ids[n]]) for n in (cycles[0][0], found.order[cycles[0][0]]))
        text = (
            f"the lights have another order: {moved} of {len(ids)} are at the places of others, "
            f"for example {first} at that of {place}: {_REMEDY}"
        )
    else:
        said = [_exchange(cycle, found, ids) for cycle in cycles]
        text = f"{'; '.join(said)}: {_REMEDY}"
    yield Notice("lights-swapped", text)


def _exchange(cycle: Sequence[int], found: Explanation, ids: Sequence[str]) -> str:
    if len(cycle) == 2:
        return f"{named([ids[n] for n in sorted(cycle)])} are swapped"
    first, place = (named([ids[n]]) for n in (cycle[0], found.order[cycle[0]]))
    among = named([ids[n] for n in sorted(cycle)])
    return f"{among} are exchanged: {first} is at the place of {place}"


def _vector(vector: Float64) -> str:
    return "(" + ", ".join(f"{figure(value, 3)}" for value in np.round(vector, 4) + 0.0) + ")"
