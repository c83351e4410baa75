"""Whether images under near lights would agree better if all lights were higher or lower."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import Lights
from rig import short_repr

Double = npt.NDArray[np.float64]

# Returns the costs ``(P, N)`` of samples if the surface is higher by some mm, under some lights.
Costs = Callable[[float, Lights], Double]


@dataclass(frozen=True, eq=False)
class CommonShift:
    """The shift of all lights along Z with which images agree best.

    Parameters
    ----------
    best_mm, sigma_mm
        The shift and its standard deviation. It is a small part of the true one, because the
        surface, which is bent under wrong lights, stays as it is.
    """

    best_mm: float
    sigma_mm: float

    __repr__ = short_repr


def raised(lights: Lights, rise_mm: float) -> Lights:
    """Return lights with positions that are all higher."""
    return replace(
        lights, positions_mm=np.asarray(lights.positions_mm) + np.array([0.0, 0.0, rise_mm])
    )


def common_shift(costs: Costs, lights: Lights, step_mm: float) -> CommonShift:
    """Estimate a shift of all lights together with a mean height, by one step of Newton.

    Parameters
    ----------
    costs
        Cost of each sample, 0 where it is missing, around a minimum of their sum.
    lights
        N lights with positions.
    step_mm
        Step of the differences.
    """

    def at(height: int, shift: int) -> Double:
        return costs(height * step_mm, raised(lights, shift * step_mm))

    here, higher, lower, up, down = at(0, 0), at(1, 0), at(-1, 0), at(0, 1), at(0, -1)
    mixed = np.sum(at(1, 1) + at(-1, -1) - at(1, -1) - at(-1, 1)) / 4
    by_height, by_shift = (np.sum(pair - 2 * here) for pair in (higher + lower, up + down))
    curvature = np.array([[by_height, mixed], [mixed, by_shift]]) / step_mm**2
    if not (by_height > 0 and np.linalg.det(curvature) > 0):
        return CommonShift(0.0, np.inf)
    inverse = np.linalg.inv(curvature)
    slopes = np.stack([higher - lower, up - down]) / (2 * step_mm)
    best = -inverse @ slopes.sum(axis=(1, 2))
    variances = []
    # Between pixels by noise, between lights also by their errors, see `MeanHeightSearch`.
    for axis in (1, 2):
        of_one = slopes.sum(axis=axis)
        free = max(of_one.shape[1] - 4, 1) / of_one.shape[1]
        scatter = of_one - of_one.mean(axis=1, keepdims=True)
        variances.append(float((inverse @ (scatter @ scatter.T / free) @ inverse)[1, 1]))
    return CommonShift(float(best[1]), float(np.sqrt(max(variances))))
