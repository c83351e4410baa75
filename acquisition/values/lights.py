"""The lights of a recording: directions or positions, intensities, axes and radiation patterns."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition.values.image_names import light_id, unpadded
from acquisition.values.light_errors import LightErrors, tangent_basis
from acquisition.values.running_numbers import pair_by_number
from acquisition.values.setup import Calibrated
from rig import Notice, pluralize
from rig.arrays import Float64

_OF_LED = re.compile(r"l([0-9]{1,9})(?:_e[0-9]+)?(?:_r[0-9]+)?(?:\.z[0-9]*)?")
# Closer points coincide with a light, so that the direction toward it is undefined.
_TOUCHING_MM = 1e-9


def led_id(led: int) -> str:
    """Return the light id of an LED: ``L07`` for LED 7.

    Examples
    --------
    >>> from acquisition.values import led_id
    >>> led_id(7)
    'L07'
    """
    return f"L{led:02d}"


def led_of(name: str) -> int | None:
    """Return the LED number in the name of a light or frame, or None.

    Examples
    --------
    >>> from acquisition.values import led_of
    >>> led_of("L05_E0_R1.tif")
    5
    """
    match = _OF_LED.fullmatch(light_id(name))
    return None if match is None else int(match[1])


# Larger lengths overflow when squared, or have no meaning in millimetres.
_LARGEST = 1e12


@dataclass(frozen=True, eq=False)
class Lights:
    """N lights, all distant (directions) or all near (positions).

    Parameters
    ----------
    directions
        ``(N, 3)`` vectors from the scene toward the lights, in the house frame (X right, Y up,
        Z toward the camera). Stored as unit vectors. None for near lights.
    positions_mm
        ``(N, 3)`` positions in the house frame, millimetres. None for distant lights.
    intensities
        ``(N, 3)`` or ``(N,)``, RGB or one value, greater than 0: the irradiance of a light at the
        frame's origin on a surface that faces it, in the unit of the images. Default: 1.
    axes
        ``(N, 3)`` unit vectors along which near lights shine, pointing away from the light.
        Default: toward the origin.
    mu
        ``(N,)`` exponent of the radiation pattern ``cos(angle to the axis) ** mu``; 0 is isotropic.
    ids
        N names that link lights to frames: ``L07`` for LED 7, or the stem of an image file.
    errors
        Covariances, standard deviations and residuals; None if they are not known.
    calibrated
        When and with what the lights were calibrated; None if this is not known.
    warnings
        What was assumed when the lights were read from a file that leaves it open.

    Raises
    ------
    DataError
        If shapes do not match, a value is not finite, a direction is zero, a position is at the
        origin, an intensity is not positive, or `errors` are invalid. The message names the light.
    """

    directions: Float64 | None = None
    positions_mm: Float64 | None = None
    intensities: Float64 | None = None
    axes: Float64 | None = None
    mu: Float64 | None = None
    ids: tuple[str, ...] = ()
    errors: LightErrors | None = None
    calibrated: Calibrated | None = None
    warnings: tuple[Notice, ...] = ()

    def __repr__(self) -> str:
        kind = "direction" if self.positions_mm is None else "position"
        unit = "" if self.positions_mm is None else " in mm"
        last = f" to {self.ids[-1]}" if len(self) > 1 else ""
        return f"Lights({pluralize(len(self), kind)}{unit}, {self.ids[0]}{last})"

    def __post_init__(self) -> None:
        chosen = self.directions if self.positions_mm is None else self.positions_mm
        if chosen is None or (self.directions is not None and self.positions_mm is not None):
            raise DataError("lights need either directions or positions, not both")
        vectors = _finite(chosen, "direction" if self.positions_mm is None else "position")
        count = len(vectors)
        ids = tuple(self.ids) or tuple(map(led_id, range(count)))
        if len(ids) != count:
            given, needed = pluralize(len(ids), "id"), pluralize(count, "light")
            raise DataError(f"{given} for {needed}: give each light an id")
        length = np.linalg.norm(vectors, axis=1)
        if np.any(length < 1e-9):
            raise DataError(f"light {ids[int(np.argmin(length))]} is a zero vector")
        if self.positions_mm is None:
            object.__setattr__(self, "directions", vectors / length[:, None])
        else:
            object.__setattr__(self, "positions_mm", vectors)
        intensities = np.ones((count, 3)) if self.intensities is None else self.intensities
        intensities = np.asarray(intensities, np.float64)
        if intensities.ndim == 1:
            intensities = np.repeat(intensities[:, None], 3, axis=1)
        if intensities.shape != (count, 3):
            raise DataError(f"intensities of shape {intensities.shape} for {count} lights")
        bad = ~np.all(np.isfinite(intensities) & (intensities > 0), axis=1)
        if bad.any():
            raise DataError(
                f"light {ids[int(np.argmax(bad))]} has an intensity that is not a positive number"
            )
        object.__setattr__(self, "intensities", intensities)
        axes = -vectors / length[:, None] if self.axes is None else _finite(self.axes, "axis")
        axis_length = np.linalg.norm(axes, axis=1)
        if len(axes) != count or np.any(axis_length < 1e-9):
            raise DataError(f"{count} lights need {count} axes of non-zero length")
        object.__setattr__(self, "axes", axes / axis_length[:, None])
        mu = np.zeros(count) if self.mu is None else np.asarray(self.mu, np.float64)
        if mu.shape != (count,) or not np.all(np.isfinite(mu) & (mu >= 0)):
            raise DataError(f"{count} lights need {count} finite values mu >= 0")
        object.__setattr__(self, "mu", mu)
        object.__setattr__(self, "ids", ids)
        if self.errors is not None:
            object.__setattr__(self, "errors", self.errors.checked(ids, near=self.near))

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def near(self) -> bool:
        """Whether the lights have positions."""
        return self.positions_mm is not None

    @property
    def unit_directions(self) -> Float64:
        """``(N, 3)`` unit vectors from the origin toward the lights, for near lights too."""
        if self.positions_mm is None:
            return _known(self.directions)
        length = np.linalg.norm(self.positions_mm, axis=1, keepdims=True)
        directions: Float64 = self.positions_mm / length
        return directions

    def distant(self) -> Lights:
        """Return the same lights with directions from the origin instead of positions."""
        errors = self.errors
        if errors is not None and self.positions_mm is not None:
            errors = errors.of_directions(self.positions_mm)
        return Lights(
            directions=self.unit_directions,
            intensities=self.intensities,
            ids=self.ids,
            errors=errors,
            calibrated=self.calibrated,
        )

    def at_distance(self, distance_mm: float, around_mm: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Lights:
        """Return lights with directions as lights at a distance from the point they refer to.

        The lamps are equally bright in all directions, and at this point as bright as before.

        Parameters
        ----------
        distance_mm
            Distance of all lights from the point.
        around_mm
            The point, in the house frame.

        Raises
        ------
        DataError
            If the lights have positions, the distance is not a number above 0, or a light comes to
            lie at the origin, for which intensities are stated.

        Examples
        --------
        >>> from acquisition import Lights
        >>> dome = Lights(directions=[[0, 0, 1], [0.6, 0, 0.8]]).at_distance(500)
        >>> dome.positions_mm.tolist()
        [[0.0, 0.0, 500.0], [300.0, 0.0, 400.0]]
        """
        if self.near:
            raise DataError("the lights have positions: a distance is for lights with directions")
        if not 0 < distance_mm < _LARGEST:
            raise DataError(f"a distance of the lights of {distance_mm:g} mm is not usable")
        around = np.asarray(around_mm, np.float64)
        directions, errors = self.unit_directions, self.errors
        if errors is not None and errors.covariances is not None:
            basis = distance_mm * tangent_basis(directions)
            covariances = basis.transpose(0, 2, 1) @ errors.covariances @ basis
            errors = replace(errors, covariances=covariances)
        near = Lights(
            positions_mm=around + distance_mm * directions,
            axes=-directions,
            ids=self.ids,
            calibrated=self.calibrated,
        )
        seen = np.linalg.norm(near.vectors_at(around), axis=1)[:, None]
        if errors is not None and errors.intensity_std is not None:
            errors = replace(errors, intensity_std=errors.intensity_std / seen)
        return replace(near, intensities=np.asarray(self.intensities) / seen, errors=errors)

    def take(self, indices: Sequence[int]) -> Lights:
        """Return the lights with these indices, in this order."""
        pick = list(indices)
        names = ("directions", "positions_mm", "intensities", "axes", "mu")
        known = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(
            self,
            **{name: values[pick] for name, values in known.items()},
            ids=tuple(self.ids[i] for i in pick),
            errors=None if self.errors is None else self.errors.take(pick),
        )

    def vectors_at(self, points_mm: npt.ArrayLike) -> Float64:
        """Return the light vectors at scene points: unit direction times relative irradiance.

        The irradiance of a Lambertian surface is ``intensity * max(n . v, 0)``, where ``v`` is the
        light vector. For near lights ``|v| = (r0 / r)^2 * (cos t / cos t0)^mu``, where r is the
        distance and t the angle to the axis, and r0 and t0 are those of the origin (the LED model
        of Queau et al., 2018, scaled to 1 at the origin). Points behind the plane of the LED and
        points that coincide with the LED receive no light.

        Parameters
        ----------
        points_mm
            ``(..., 3)`` points in the house frame.

        Returns
        -------
        Array
            ``(N, ..., 3)`` float64.
        """
        points = np.asarray(points_mm, np.float64)
        shape = (len(self),) + (1,) * (points.ndim - 1) + (3,)
        if self.positions_mm is None:
            constant = _known(self.directions).reshape(shape)
            return np.broadcast_to(constant, (len(self), *points.shape)).copy()
        position = self.positions_mm.reshape(shape)
        axis = _known(self.axes).reshape(shape)
        mu = _known(self.mu).reshape(shape[:-1])
        toward = position - points
        distance = np.linalg.norm(toward, axis=-1)
        distance = np.where(distance > _TOUCHING_MM, distance, np.inf)
        reference = np.linalg.norm(position, axis=-1)
        cosine = np.clip(-np.sum(toward * axis, axis=-1) / distance, 0.0, None)
        cosine_reference = -np.sum(position * axis, axis=-1) / reference
        if np.any(cosine_reference <= 0):
            dark = self.ids[int(np.argmin(cosine_reference.ravel()))]
            raise DataError(f"light {dark} points away from the origin: correct its axis")
        gain = (reference / distance) ** 2 * (cosine / cosine_reference) ** mu
        gain = np.where(cosine > 0, gain, 0.0)
        vectors: Float64 = toward / distance[..., None] * gain[..., None]
        return vectors

    def match(self, names: Sequence[str]) -> tuple[list[int], bool]:
        """Find the light of each frame by its id or LED, or by number or order if no names match.

        Different names with the same LED number, for instance ``L05`` and ``L05_E0.tif``, mean the
        same light. If both lights and frames are named after LEDs, they are never matched by order.
        If no names match, but both have the same numbers (``light_3``, ``IMG_0003``), these count.

        Parameters
        ----------
        names
            One id or file name per frame.

        Returns
        -------
        indices
            Index of the light of each frame.
        by_name
            False if the lights were matched by number or order; callers should then issue a
            warning.

        Raises
        ------
        DataError
            If only some names match, or if no names match and the counts differ, the order of the
            images cannot be known from their names, or it contradicts the numbers in the names.
        """
        exact = _found(light_id, self.ids, names)
        by_led = _found(_led_or_id, self.ids, names)
        by_name = _found(unpadded, self.ids, names)
        for matches in (exact, by_led, by_name):
            if len(matches) == len(names) == len(set(matches.values())):
                return [matches[name] for name in names], True
        if len(names) != len(self):
            raise DataError(
                f"{pluralize(len(names), 'image')} for {pluralize(len(self), 'light')}: "
                "every image needs a light, by file name, or by order if the counts are equal"
            )
        # The default ids of lights without names express only their order.
        named = self.ids != tuple(map(led_id, range(len(self))))
        leds = all(led_of(name) is not None for name in (*self.ids, *names))
        if exact or (named and (by_led or by_name or leds)):
            by_led = by_name | by_led
            missing = next((name for name in names if name not in by_led), None)
            if missing is None:
                raise DataError("two images or two lights share a name: rename one of them")
            raise DataError(
                f"{len(by_led)} of {len(names)} image names match a light, {missing} does not: "
                "rename the images or the lights"
            )
        ids = self.ids if named else ()
        return pair_by_number(ids, names), False


def _led_or_id(name: str) -> str:
    """Return the light id of the LED in a name, or `light_id` of a name without an LED."""
    led = led_of(name)
    return light_id(name) if led is None else led_id(led).casefold()


def _found(
    reduced: Callable[[str], str], ids: Sequence[str], names: Sequence[str]
) -> dict[str, int]:
    """Return the index of the only id with the same reduced name, for names that have one."""
    keys = [reduced(light) for light in ids]
    counts = Counter(keys)
    places = {key: i for i, key in enumerate(keys) if counts[key] == 1}
    return {name: places[key] for name in names if (key := reduced(name)) in places}


def _known(value: Float64 | None) -> Float64:
    """Narrow the type of a field that the constructor sets."""
    if value is None:
        raise TypeError("a field that the constructor sets is missing")
    return value


def _finite(value: npt.ArrayLike, name: str) -> Float64:
    array = np.array(value, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        plural = "axes" if name == "axis" else f"{name}s"
        raise DataError(f"{plural} of lights must be N x 3 numbers, not {array.shape}")
    bad = ~(np.abs(array) <= _LARGEST).all(axis=1)
    if bad.any():
        raise DataError(
            f"the {name} of light {int(np.argmax(bad))} is not finite, or larger than {_LARGEST:g}"
        )
    return array
