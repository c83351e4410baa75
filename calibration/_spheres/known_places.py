"""Whether LED positions that are known independently agree with an explanation of a wrong value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition import DataError
from calibration._spheres.robust import Array
from rig import short_repr

# Error that all positions of a rig file have in common, as a share: a dome has its nominal radius
# to about 1 mm, and a tape measures to the lens of an LED, not to its chip.
_COMMON_SHARE = 3e-3
# Fewer places do not determine their own scatter.
_FEWEST = 4
# A larger scatter, relative to the distances from the middle, means another order or another rig.
_LARGEST_SCATTER = 0.1


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
) -> Array:
    """Return the known places ``(N, 3)`` of lights; NaN where a place is not known.

    Raises
    ------
    DataError
        If a place is not three finite numbers.
    """
    places = np.full((len(names), 3), np.nan)
    for name, place in (led_positions_mm or {}).items():
        point: npt.NDArray[np.float64] = np.asarray(place, np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise DataError(f"the position of LED {name} must be 3 finite numbers in mm")
        if name in names:
            places[names.index(name)] = point
    return places


def factor_of(lights_mm: Array, places_mm: Array) -> Factor | None:
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
