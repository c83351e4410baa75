"""The lights of a recording: directions or positions, how strong, and where they point."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition._errors import DataError
from acquisition._suffixes import IMAGE_SUFFIXES, RAW_SUFFIXES

Array = npt.NDArray[np.float64]

_SUFFIXES = IMAGE_SUFFIXES | RAW_SUFFIXES
_OF_LED = re.compile(r"l([0-9]{1,9})(?:_e[0-9]+)?(?:_r[0-9]+)?(?:\.z[0-9]*)?")
# Where a point coincides with a light, so that no direction leads to it.
_TOUCHING_MM = 1e-9


def led_id(led: int) -> str:
    """Return the name of the light that an LED makes: ``L07`` for LED 7."""
    return f"L{led:02d}"


def led_of(name: str) -> int | None:
    """Return the LED that a name of a light or frame tells, 5 for ``L05_E0_R1.tif``, or None."""
    found = _OF_LED.fullmatch(light_id(name))
    return None if found is None else int(found[1])


def light_id(name: str) -> str:
    r"""Reduce a file name or path to what identifies a light: its stem, any separator, any case.

    Idempotent: ``chrome.0.tga``, ``D:\scan\CHROME.0.TGA`` and ``chrome.0`` are all ``chrome.0``.
    Only suffixes of images and camera RAW are taken off: ``scan.left`` stays whole.
    """
    stem = re.split(r"[\\/]", name.rstrip("\\/"))[-1].casefold()
    while True:
        shorter, _, suffix = stem.rpartition(".")
        if not shorter or f".{suffix}" not in _SUFFIXES:
            return stem
        stem = shorter


# Lengths beyond this have no square, or no meaning in millimetres.
_LARGEST = 1e12


@dataclass(frozen=True, eq=False)
class Lights:
    """N lights, either all distant (directions) or all near (positions).

    Parameters
    ----------
    directions
        ``(N, 3)`` vectors from the scene toward the lights, in the house frame (X right, Y up,
        Z toward the camera). Stored as unit vectors. None for near lights.
    positions_mm
        ``(N, 3)`` positions in the house frame, millimetres. None for distant lights.
    intensities
        ``(N, 3)`` or ``(N,)``, RGB or one value, greater than 0: the irradiance a light gives at
        the frame's origin on a surface that faces it, in the unit of the images. Default 1.
    axes
        ``(N, 3)`` unit vectors along which near lights shine, pointing away from the light.
        Default: at the origin.
    mu
        ``(N,)`` exponent of the radiation pattern ``cos(angle to the axis) ** mu``; 0 is isotropic.
    ids
        N names that tie lights to frames: ``L07`` for LED 7, or the stem of an image file.

    Raises
    ------
    DataError
        If shapes disagree, a value is not finite, a direction has no length, a position lies at
        the origin, or an intensity is not positive. The message names the light.
    """

    directions: Array | None = None
    positions_mm: Array | None = None
    intensities: Array | None = None
    axes: Array | None = None
    mu: Array | None = None
    ids: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given = self.directions if self.positions_mm is None else self.positions_mm
        if given is None or (self.directions is not None and self.positions_mm is not None):
            raise DataError("lights need either directions or positions, and not both")
        vectors = _finite(given, "direction" if self.positions_mm is None else "position")
        count = len(vectors)
        ids = tuple(self.ids) or tuple(map(led_id, range(count)))
        if len(ids) != count:
            raise DataError(f"{count} lights but {len(ids)} ids")
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
            raise DataError(f"{count} lights but intensities of shape {intensities.shape}")
        bad = ~np.all(np.isfinite(intensities) & (intensities > 0), axis=1)
        if bad.any():
            raise DataError(
                f"light {ids[int(np.argmax(bad))]} has an intensity that is not a positive number"
            )
        object.__setattr__(self, "intensities", intensities)
        axes = -vectors / length[:, None] if self.axes is None else _finite(self.axes, "axis")
        axis_length = np.linalg.norm(axes, axis=1)
        if len(axes) != count or np.any(axis_length < 1e-9):
            raise DataError(f"{count} lights need {count} axes that are not zero")
        object.__setattr__(self, "axes", axes / axis_length[:, None])
        mu = np.zeros(count) if self.mu is None else np.asarray(self.mu, np.float64)
        if mu.shape != (count,) or not np.all(np.isfinite(mu) & (mu >= 0)):
            raise DataError(f"{count} lights need {count} values mu >= 0")
        object.__setattr__(self, "mu", mu)
        object.__setattr__(self, "ids", ids)

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def near(self) -> bool:
        """True where the lights have positions."""
        return self.positions_mm is not None

    @property
    def unit_directions(self) -> Array:
        """``(N, 3)`` unit vectors from the origin toward the lights, for near lights too."""
        if self.positions_mm is None:
            return _known(self.directions)
        length = np.linalg.norm(self.positions_mm, axis=1, keepdims=True)
        directions: Array = self.positions_mm / length
        return directions

    def distant(self) -> Lights:
        """Return the same lights as seen from the origin, with no positions."""
        return Lights(directions=self.unit_directions, intensities=self.intensities, ids=self.ids)

    def take(self, indices: Sequence[int]) -> Lights:
        """Return the lights of these indices, in this order."""
        pick = list(indices)
        return replace(
            self,
            directions=None if self.directions is None else self.directions[pick],
            positions_mm=None if self.positions_mm is None else self.positions_mm[pick],
            intensities=_known(self.intensities)[pick],
            axes=_known(self.axes)[pick],
            mu=_known(self.mu)[pick],
            ids=tuple(self.ids[i] for i in pick),
        )

    def vectors_at(self, points_mm: npt.ArrayLike) -> Array:
        """Return the light vectors at scene points: unit direction times relative irradiance.

        The irradiance of a Lambertian surface is ``intensity * max(n . v, 0)`` with ``v`` from
        here. For near lights ``|v| = (r0 / r)^2 * (cos t / cos t0)^mu``, with distance r and angle
        t to the axis, r0 and t0 those of the origin (the LED model of Queau et al., 2018, scaled
        to 1 at the origin). Points behind the LED's own plane get no light, nor do points that
        coincide with the LED.

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
            raise DataError(f"light {dark} points away from the origin: check its axis")
        gain = (reference / distance) ** 2 * (cosine / cosine_reference) ** mu
        gain = np.where(cosine > 0, gain, 0.0)
        vectors: Array = toward / distance[..., None] * gain[..., None]
        return vectors

    def match(self, names: Sequence[str]) -> tuple[list[int], bool]:
        """Find each frame's light by its id, or by its LED, or by order where no names match.

        Names that differ and tell an LED, as ``L05`` and ``L05_E0.tif`` do, are those of one light.
        Where lights and frames are both called after LEDs, the order never decides.

        Parameters
        ----------
        names
            One id or file name per frame.

        Returns
        -------
        indices
            The light of each frame.
        by_name
            False where order decided, which deserves a warning.

        Raises
        ------
        DataError
            If names match only in part, or not at all and the counts differ.
        """
        exact = _found(light_id, self.ids, names)
        by_led = _found(_led_or_id, self.ids, names)
        for found in (exact, by_led):
            if len(found) == len(names) == len(set(found.values())):
                return [found[name] for name in names], True
        if len(names) != len(self):
            raise DataError(
                f"{len(names)} images for {len(self)} lights: "
                "every image needs its light (by file name, or by order when the counts agree)"
            )
        # What lights without names are called by default tells no more than their order.
        named = self.ids != tuple(map(led_id, range(len(self))))
        leds = all(led_of(name) is not None for name in (*self.ids, *names))
        if exact or (named and (by_led or leds)):
            missing = next((name for name in names if name not in by_led), None)
            if missing is None:
                raise DataError("two images or two lights share a name: rename them")
            raise DataError(
                f"{len(by_led)} of {len(names)} image names are in the lights, {missing} is not: "
                "rename the images or the lights"
            )
        return list(range(len(self))), False


def _led_or_id(name: str) -> str:
    """Reduce a name to its LED, where it tells one, or as `light_id`."""
    led = led_of(name)
    return light_id(name) if led is None else led_id(led).casefold()


def _found(
    reduced: Callable[[str], str], ids: Sequence[str], names: Sequence[str]
) -> dict[str, int]:
    """Return the index of the one id that each name is reduced to, for names that have one."""
    known = [reduced(light) for light in ids]
    often = Counter(known)
    place = {key: i for i, key in enumerate(known) if often[key] == 1}
    return {name: place[key] for name in names if (key := reduced(name)) in place}


def _known(value: Array | None) -> Array:
    """Narrow a field that the constructor filled in."""
    if value is None:
        raise TypeError("a field that the constructor fills in is missing")
    return value


def _finite(value: npt.ArrayLike, what: str) -> Array:
    array = np.array(value, np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise DataError(f"{what}s of lights must be N x 3 numbers, not {array.shape}")
    bad = ~(np.abs(array) <= _LARGEST).all(axis=1)
    if bad.any():
        raise DataError(
            f"the {what} of light {int(np.argmax(bad))} is not finite, or larger than {_LARGEST:g}"
        )
    return array
