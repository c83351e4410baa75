"""Measurements of areas, profiles and steps, with the uncertainty of each parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from acquisition import DataError
from processing.maps.mask import bounding_box
from processing.roughness.areal_parameters import AREAL, Parameter, areal_parameters
from processing.roughness.line import Line
from processing.roughness.profile_parameters import (
    PROFILE,
    profile_parameters,
    scale_limited_profile,
)
from processing.roughness.scale_limited import Resolution, Scales, scale_limited
from processing.roughness.step_height import STEP, step_height
from processing.roughness.uncertainty import ErrorModel, Evaluate, Quantity, quantities
from rig import Progress, no_progress, short_repr
from rig.arrays import Bool, Float64, Floating

# A parameter of which noise makes more than this share is not assured.
_MOST_NOISE = 0.5
# Texture of which the aspect ratio is larger has no direction.
_LEAST_STRIPED = 0.5
# Side, in pixels, of the part of a large area that shows its uncertainty. A longer L-filter is left
# out of it.
_SAMPLE_PX = 768
# Narrowest flank of a step that normals resolve.
_LEAST_FLANK_PX = 5.0


@dataclass(frozen=True, eq=False)
class Area:
    """What was measured in an area.

    Parameters
    ----------
    quantities
        The parameters by name.
    scales
        Form and filters, with both nesting indices.
    heights_mm
        ``(H, W)`` scale-limited heights, NaN outside the area.
    resolution
        What the instrument transmits.
    """

    quantities: Mapping[str, Quantity]
    scales: Scales
    heights_mm: Floating
    resolution: Resolution

    __repr__ = short_repr


def measure_area(
    heights_mm: Floating,
    area: Bool,
    resolution: Resolution,
    scales: Scales | None = None,
    errors: ErrorModel | None = None,
    *,
    on_progress: Progress = no_progress,
) -> Area:
    """Return the parameters of an area (ISO 25178-2), with uncertainties.

    Parameters
    ----------
    heights_mm
        ``(H, W)``, NaN where they are not known.
    area
        ``(H, W)`` bool, the pixels that count.
    resolution
        What the instrument transmits.
    scales
        Form and filters; None for a plane and nesting indices by pixels and area.
    errors
        Of the heights; None for no uncertainties.
    on_progress
        Receives the stage ``uncertainty of parameters``.

    Raises
    ------
    DataError
        If the area has too few known heights, or is too small for the filters.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import Resolution, measure_area
    >>> y, x = np.mgrid[:120, :160] * 0.01
    >>> heights = 0.001 * np.sin(2 * np.pi * x / 0.2)
    >>> found = measure_area(heights, np.ones(x.shape, bool), Resolution(0.01))
    >>> found.scales.s_mm, found.scales.l_mm
    (0.05, 0.2)
    >>> found.quantities["Sa"].unit
    'um'
    """
    inside = area & np.isfinite(heights_mm)
    if not inside.any():
        raise DataError("the area has no known heights")
    pixel = resolution.pixel_mm
    rows, columns = bounding_box(inside)
    side = pixel * min(rows.stop - rows.start, columns.stop - columns.start)
    chosen = (scales or Scales()).resolved(resolution, side)
    margin = math.ceil(max(chosen.s_mm or 0, chosen.l_mm or 0) / pixel)
    window = (
        slice(max(rows.start - margin, 0), rows.stop + margin),
        slice(max(columns.start - margin, 0), columns.stop + margin),
    )
    heights, within = heights_mm[window], inside[window]

    limited = scale_limited(heights, within, chosen, resolution)
    values = areal_parameters(limited, pixel)
    cropped = None if errors is None else errors.cropped(window)
    sample = None if cropped is None else _sample(within)
    if sample is None or cropped is None:
        evaluate = _evaluation(within, chosen)
        found = quantities(
            evaluate, values, heights, resolution, cropped, AREAL, on_progress=on_progress
        )
    else:
        long = (chosen.l_mm or 0) / pixel > _SAMPLE_PX / 2
        evaluate = _evaluation(within[sample], replace(chosen, l_mm=0.0) if long else chosen)
        of_part = quantities(
            evaluate,
            evaluate(heights[sample], resolution, False),
            heights[sample],
            resolution,
            cropped.cropped(sample),
            AREAL,
            on_progress=on_progress,
        )
        found = {name: _extended(one, values[name]) for name, one in of_part.items()}
    if limited.shape != heights_mm.shape:
        whole = np.full(heights_mm.shape, np.nan, heights_mm.dtype)
        whole[window] = limited
        limited = whole
    return Area(_with_doubts(found, shown=resolution.shown), chosen, limited, resolution)


def _evaluation(area: Bool, scales: Scales) -> Evaluate:
    """Return what evaluates the parameters of an area."""

    def evaluate(heights: Floating, seen: Resolution, other: bool) -> dict[str, float]:
        limited = scale_limited(heights, area, scales, seen, other_fit=other)
        return areal_parameters(limited, seen.pixel_mm)

    return evaluate


def _with_doubts(found: Mapping[str, Quantity], *, shown: bool) -> dict[str, Quantity]:
    """Return the quantities of an area with doubts about their uncertainties."""
    # Where the surface is sharpest, blur removes more than the linear budget states.
    unseen = () if shown else ("a single point decides, and the blur of the lens is not known",)
    doubts = dict.fromkeys(("Sp", "Sv", "Sz"), unseen)
    if found["Str"].value >= _LEAST_STRIPED:
        doubts["Std"] = ("the texture has no main direction",)
    return {name: _doubted(one, doubts.get(name, ())) for name, one in found.items()}


def _sample(area: Bool) -> tuple[slice, slice] | None:
    """Return the window of a large area that shows its uncertainty; None for a small area."""
    if np.count_nonzero(area) <= 2 * _SAMPLE_PX**2:
        return None
    steps = [range(0, max(size - _SAMPLE_PX, 0) + 1, _SAMPLE_PX // 2) for size in area.shape]
    windows = [
        (slice(row, row + _SAMPLE_PX), slice(column, column + _SAMPLE_PX))
        for row, column in product(*steps)
    ]
    return max(windows, key=lambda window: np.count_nonzero(area[window]))


def _extended(quantity: Quantity, whole: float) -> Quantity:
    """Return a quantity of a complete area from that of a part of it.

    Noise adds the same share to heights and slopes of both; the deviation of the part is an upper
    limit of that of the whole, whose noise averages over more pixels.
    """
    relative = AREAL[quantity.name].kind in ("height", "slope") or quantity.name == "Sdr"
    if not math.isfinite(whole) or not quantity.budget:
        return replace(quantity, measured=whole, result=whole)
    if relative and quantity.measured:
        factor = whole / quantity.measured
        budget = {source: factor * part for source, part in quantity.budget.items()}
        return replace(quantity, measured=whole, result=factor * quantity.result, budget=budget)
    return replace(quantity, measured=whole, result=quantity.result + (whole - quantity.measured))


@dataclass(frozen=True, eq=False)
class LineMeasurement:
    """What was measured along a line.

    Parameters
    ----------
    quantities
        The parameters by name.
    scales
        Form and filters, with both nesting indices; None for a step.
    heights_mm
        ``(N,)`` heights along the line, one per pixel.
    """

    quantities: Mapping[str, Quantity]
    scales: Scales | None
    heights_mm: Float64

    __repr__ = short_repr


def measure_profile(
    heights_mm: Floating,
    line: Line,
    resolution: Resolution,
    scales: Scales | None = None,
    errors: ErrorModel | None = None,
    *,
    on_progress: Progress = no_progress,
) -> LineMeasurement:
    """Return the parameters of a profile (ISO 21920-2), with uncertainties.

    Parameters are those of `measure_area`, with a line instead of an area.

    Raises
    ------
    DataError
        If the line leaves the image, crosses a hole, or is too short for the filters.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import Line, Resolution, Scales, measure_profile
    >>> y, x = np.mgrid[:120, :160] * 0.01
    >>> heights = 0.001 * np.sin(2 * np.pi * x / 0.2)
    >>> scales = Scales("level", 0.05, 0)
    >>> found = measure_profile(heights, Line(0, 60, 159, 60), Resolution(0.01), scales)
    >>> round(found.quantities["RSm"].value, 2)
    0.2
    """
    heights = line.of(heights_mm)
    chosen = (scales or Scales()).resolved(resolution, line.length_px * resolution.pixel_mm)

    def evaluate(values: Floating, seen: Resolution, other: bool) -> dict[str, float]:
        way = replace(chosen, robust=chosen.robust != other)
        return profile_parameters(
            scale_limited_profile(values.ravel().astype(np.float64), way, seen)
        )

    found = _along(evaluate, heights_mm, line, resolution, errors, PROFILE, on_progress)
    return LineMeasurement(found, chosen, heights)


def measure_step(
    heights_mm: Floating,
    line: Line,
    resolution: Resolution,
    errors: ErrorModel | None = None,
    *,
    known_mm: float | None = None,
    on_progress: Progress = no_progress,
) -> LineMeasurement:
    """Return the height of a step, or the depth of a groove (ISO 5436-1), with its uncertainty.

    Parameters
    ----------
    heights_mm, line, resolution, errors, on_progress
        As for `measure_profile`.
    known_mm
        Standard deviation of known heights on both sides, which determine a step with a narrow
        flank; None if normals of the flank do, which must be resolved.

    Raises
    ------
    DataError
        As `measure_profile`, or if a flank is too narrow.
    EstimateError
        If there is no step.

    Examples
    --------
    >>> import numpy as np
    >>> from processing.roughness import Line, Resolution, measure_step
    >>> y, x = np.mgrid[:120, :160] * 0.01
    >>> heights = np.clip((x - 0.8) / 0.1, -1, 1) * 0.025
    >>> found = measure_step(heights, Line(10, 60, 150, 60), Resolution(0.01))
    >>> round(found.quantities["d"].value, 3)
    50.0
    """
    heights = line.of(heights_mm)
    if not np.isfinite(heights).all():
        raise DataError(
            "the line crosses a hole or a jump: heights on its two sides are not connected; "
            "integrate the surface with known heights on both sides"
        )
    flank = step_height(heights).flank_px
    if flank < _LEAST_FLANK_PX and known_mm is None:
        raise DataError(
            f"the flank is {flank:.1f} pixels wide: normals show the height of walls of "
            f"{_LEAST_FLANK_PX:g} pixels or more; integrate the surface with known heights on both "
            "sides, or record it with smaller pixels"
        )

    def evaluate(values: Floating, seen: Resolution, other: bool) -> dict[str, float]:
        step = step_height(values.ravel().astype(np.float64), rounded=2.0 if other else 1.0)
        pixel = seen.pixel_mm
        return {"d": 1000 * step.height, "W": pixel * step.width_px, "flank": pixel * step.flank_px}

    found = _along(evaluate, heights_mm, line, resolution, errors, STEP, on_progress)
    if flank < _LEAST_FLANK_PX and known_mm and found["d"].budget:
        found["d"] = found["d"].with_part("known heights", 1000 * math.sqrt(2) * known_mm)
    return LineMeasurement(found, None, heights)


def _along(
    evaluate: Evaluate,
    heights_mm: Floating,
    line: Line,
    resolution: Resolution,
    errors: ErrorModel | None,
    parameters: Mapping[str, Parameter],
    on_progress: Progress,
) -> dict[str, Quantity]:
    """Return quantities of the heights along a line; errors are integrated around it."""
    window = line.window(heights_mm.shape, int(line.length_px / 4))
    inner = line.moved(window)

    def sampled(values: Floating, seen: Resolution, other: bool) -> Mapping[str, float]:
        return evaluate(inner.of(values)[None], seen, other)

    cropped = None if errors is None else errors.cropped(window)
    part = heights_mm[window]
    values = sampled(part, resolution, False)
    found = quantities(
        sampled, values, part, resolution, cropped, parameters, on_progress=on_progress
    )
    return {name: _doubted(one) for name, one in found.items()}


def _doubted(quantity: Quantity, others: Sequence[str] = ()) -> Quantity:
    """Return a quantity with doubts about its uncertainty."""
    doubts = [*quantity.doubts, *others]
    share = abs(quantity.measured - quantity.value) / abs(quantity.measured or 1)
    if share > _MOST_NOISE:
        doubts.append(f"{share:.0%} of it is noise")
    return replace(quantity, doubts=tuple(doubts))
