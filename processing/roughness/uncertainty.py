"""Uncertainties of parameters: a budget of what contributes to each (GUM, JCGM 100:2008)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from processing.roughness.height_errors import NormalErrors
from processing.roughness.scale_limited import Resolution
from rig import Progress, no_progress
from rig.arrays import Bool, Float64, Floating

if TYPE_CHECKING:
    from uncertainties.core import AffineScalarFunc

    from processing.roughness.areal_parameters import Parameter

# Maps of simulated noise, and of simulated errors of the model. Deviations from so few are those of
# a t-distribution (JCGM 101:2008, 6.4.9).
_SAMPLES, _MODELS = 24, 12
_OF_SAMPLES = math.sqrt((_SAMPLES - 1) / (_SAMPLES - 3))
_OF_MODELS = math.sqrt(_MODELS / (_MODELS - 2))
# Relative standard deviation of the stated deviations of normals; measured ones are within 0.89 and
# 1.09 of the actual ones, decile by decile (docs/quality.md).
_OF_DEVIATIONS = 0.1
_SOMETIMES = "errors of the normals make it undefined"
# Sources of uncertainty, as in a budget.
SOURCES: Final = (
    "noise", "noise level", "model", "lights", "scale", "filter", "form", "known heights"
)  # fmt: skip
# Evaluates parameters of heights: (heights, resolution, form fitted the other way).
Evaluate = Callable[[Floating, Resolution, bool], Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class Quantity:
    """A parameter with its uncertainty.

    Parameters
    ----------
    name, unit
        Such as ``Sq`` and ``um``.
    measured
        The parameter of the heights as they are, noise included.
    result
        The parameter without what noise adds, with its standard uncertainty: a number of the
        package `uncertainties`, so results of one recording can be combined. ``nan`` if the
        parameter is not defined.
    budget
        Standard uncertainty by source, in `unit`; empty if errors are not known.
    doubts
        Why the uncertainty is not assured; empty if it is.
    """

    name: str
    unit: str
    measured: float
    result: AffineScalarFunc | float
    budget: Mapping[str, float] = field(default_factory=dict)
    doubts: tuple[str, ...] = ()

    @property
    def value(self) -> float:
        """The parameter without what noise adds."""
        return self.result if isinstance(self.result, float) else float(self.result.nominal_value)

    @property
    def sigma(self) -> float:
        """Its standard uncertainty; NaN if errors are not known."""
        return math.sqrt(sum(part**2 for part in self.budget.values())) if self.budget else math.nan

    def with_part(self, source: str, sigma: float) -> Quantity:
        """Return the same with an independent error of another source."""
        from uncertainties import ufloat

        result = self.result + ufloat(0, sigma, source)
        return replace(self, result=result, budget={**self.budget, source: sigma})


@dataclass(frozen=True, eq=False)
class ErrorModel:
    """What is known of the errors of one recording.

    Parameters
    ----------
    normals
        Of all pixels.
    scale_sigma
        Relative standard deviation of the size of a pixel.
    doubts
        Why uncertainties are not assured; empty if they are.
    """

    normals: NormalErrors
    scale_sigma: float = 0.0
    doubts: tuple[str, ...] = ()
    _shared: dict[str, AffineScalarFunc] = field(default_factory=dict, repr=False)

    def cropped(self, window: tuple[slice, slice]) -> ErrorModel:
        """Return those of a window, with the same variables."""
        return replace(self, normals=self.normals.cropped(window))

    def shared(self, source: str, number: int = 0) -> AffineScalarFunc:
        """Return the variable, of deviation 1, of an error that all results have in common."""
        from uncertainties import ufloat

        return self._shared.setdefault(f"{source} {number}", ufloat(0, 1, source))


def quantities(
    evaluate: Evaluate,
    found: Mapping[str, float],
    heights_mm: Floating,
    resolution: Resolution,
    errors: ErrorModel | None,
    parameters: Mapping[str, Parameter],
    *,
    on_progress: Progress = no_progress,
) -> dict[str, Quantity]:
    """Return parameters with their uncertainties.

    Noise is simulated: maps of errors with the covariance of the heights are added to them. What a
    map adds to a parameter, noise has added before, in the square for those parameters whose square
    grows with the variance of the noise (compare simulation and extrapolation: Cook and Stefanski,
    1994). Deviations of the normals that are not noise are simulated too, but nothing is removed.
    Lights, scale, blur and form are propagated by one standard deviation each (GUM, 5.1.2), blur in
    both directions.

    Parameters
    ----------
    evaluate
        Returns the parameters of heights.
    found
        Those of the given heights.
    heights_mm
        ``(H, W)``, NaN where they are not known.
    resolution
        What the instrument transmits.
    errors
        Of the same pixels; None if they are not known.
    parameters
        What each parameter is.
    on_progress
        Receives the stage ``uncertainty of parameters``.
    """
    names = list(found)
    start = np.array([found[name] for name in names])
    if errors is None:
        return {n: Quantity(n, parameters[n].unit, one, one) for n, one in found.items()}
    angle = np.array([parameters[name].kind == "angle" for name in names])
    noisy = np.array([parameters[name].noisy for name in names])
    total = _SAMPLES + _MODELS + 9 + 4
    done = 0

    def change(heights: Floating, seen: Resolution = resolution, *, other: bool = False) -> Float64:
        nonlocal done
        done += 1
        on_progress("uncertainty of parameters", min(done, total), total)
        values = evaluate(heights, seen, other)
        off = np.array([values[name] for name in names]) - start
        return np.asarray(np.where(angle, (off + 90) % 180 - 90, off))

    pixel = resolution.pixel_mm
    by_noise = np.array(
        [change(heights_mm + error) for error in errors.normals.noise(pixel, _SAMPLES)]
    )
    by_model = [change(heights_mm + error) for error in errors.normals.model(pixel, _MODELS)]
    by_lights = [change(heights_mm + error) for error in errors.normals.lights(pixel)]
    enlarged = 1 + errors.scale_sigma
    by_scale = change(heights_mm * enlarged, replace(resolution, pixel_mm=pixel * enlarged))
    by_blur = np.zeros_like(start)
    if resolution.blur_sigma_px:
        wider, narrower = (
            change(heights_mm, replace(resolution, blur_px=max(resolution.blur_px + off, 0)))
            for off in (resolution.blur_sigma_px, -resolution.blur_sigma_px)
        )
        # Parameters such as Smr2 are not smooth functions of the filter: the larger change counts.
        by_blur = np.copysign(np.maximum(np.abs(wider), np.abs(narrower)), wider - narrower)
    by_form = change(heights_mm, other=True) / math.sqrt(3)
    value, noise, bias = _without_noise(start, by_noise, noisy)
    results = {}
    for i, name in enumerate(names):
        budget = {
            "noise": _OF_SAMPLES * float(noise[i]),
            "noise level": float(2 * _OF_DEVIATIONS * abs(bias[i])),
            "model": _OF_MODELS * math.sqrt(sum(float(one[i]) ** 2 for one in by_model) / _MODELS),
            "lights": math.sqrt(sum(float(one[i]) ** 2 for one in by_lights)),
            "scale": abs(float(by_scale[i])),
            "filter": abs(float(by_blur[i])),
            "form": abs(float(by_form[i])),
        }
        if not np.isfinite([start[i], value[i], *budget.values()]).all():
            doubts = (_SOMETIMES,) if math.isfinite(start[i]) else ()
            known = float(start[i])
            results[name] = Quantity(name, parameters[name].unit, known, known, doubts=doubts)
            continue
        shared = [("lights", k, one[i]) for k, one in enumerate(by_lights)]
        shared += [("scale", 0, by_scale[i]), ("filter", 0, by_blur[i])]
        results[name] = Quantity(
            name,
            parameters[name].unit,
            float(start[i]),
            _combined(errors, float(value[i]), budget, shared),
            budget,
            errors.doubts,
        )
    return results


def _without_noise(
    start: Float64, changes: Float64, noisy: Bool
) -> tuple[Float64, Float64, Float64]:
    """Return values without what noise adds, their deviations by noise, and what it has added."""
    with np.errstate(invalid="ignore", divide="ignore"):
        squares = np.square(start + changes) - np.square(start)
        square = np.square(start) - squares.mean(axis=0)
        spread = squares.std(axis=0, ddof=1)
        root = np.sqrt(np.maximum(square, 0))
        # Below the noise, the square is known to its deviation.
        of_root = np.minimum(spread / (2 * root), np.sqrt(spread))
        value = np.where(noisy, root, start - changes.mean(axis=0))
        deviation = np.where(noisy, of_root, changes.std(axis=0, ddof=1))
    return value, deviation, start - value


def _combined(
    errors: ErrorModel,
    value: float,
    budget: Mapping[str, float],
    shared: list[tuple[str, int, float]],
) -> AffineScalarFunc | float:
    from uncertainties import ufloat

    parts = [float(factor) * errors.shared(name, number) for name, number, factor in shared]
    own = ("noise", "noise level", "model", "form")
    parts += [ufloat(0, budget[source], source) for source in own if budget[source] > 0]
    result: AffineScalarFunc | float = sum(parts, value)
    return result
