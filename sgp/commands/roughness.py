"""``sgp roughness``: parameters of areas, profiles and steps, with their uncertainty."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

import acquisition
import calibration
import rig
from processing.maps.mask import bounding_box
from processing.roughness import (
    Form,
    Line,
    Scales,
    applied,
    measure_area,
    measure_profile,
    measure_step,
    read_limits,
)
from sgp.cli.console import Stages
from sgp.cli.exit import UNUSABLE
from sgp.cli.options import Input, NotNegative, OptionalInput, Percent, Pixels, Positive
from sgp.cli.places import Region, lines, regions
from sgp.results import Result, RoughnessMetrics, claim_folder, writes_folder
from sgp.stages import Measured, SurfaceInput, read_surface, write_roughness
from sgp.stages.write_roughness import limit_metrics, text_of

if TYPE_CHECKING:
    from rig.arrays import Bool

# Share of an area without heights, or in parts other than the largest one, worth a notice.
_OTHER_PARTS = 0.01


@writes_folder("roughness.json")
def roughness(
    result: Input,
    *,
    region: tuple[str, ...] = (),
    line: tuple[str, ...] = (),
    step: tuple[str, ...] = (),
    form: Form = "plane",
    s_mm: Positive | None = None,
    l_mm: NotNegative | None = None,
    robust: bool = False,
    scale_percent: Percent = 0.0,
    limits: OptionalInput = None,
    out: Path | None = None,
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Measure roughness, waviness, steps and grooves, with expanded uncertainties.

    Areas have the parameters of ISO 25178-2, profiles those of ISO 21920-2, steps and grooves those
    of ISO 5436-1. What noise adds to a parameter is removed from it. Without --region, --line and
    --step, the complete surface is one area. The exit code is 6 if a limit is exceeded.

    For example:

        sgp roughness out --out roughness
        sgp roughness out --region rim=100,80,400,400 --form quadric --l-mm 0.8
        sgp roughness out --line 20,200,620,200,5 --step 300,50,300,250
        sgp roughness part --region seal.png --limits seal.toml --out check

    Parameters
    ----------
    result
        Folder of sgp run, sgp demo or sgp surface, with heights in mm.
    region
        Area: NAME=X,Y,W,H in pixels, or the file of a mask; the name may be left out. The option
        may be given several times.
    line
        Profile: NAME=X0,Y0,X1,Y1 in pixels, and perhaps ,WIDTH: the number of parallel lines whose
        mean counts.
    step
        Line across a step or a groove, as for --line.
    form
        Form that is removed first: none, level (the mean), plane, a polynomial of order 2 to 5
        (quadric, cubic, quartic, quintic), sphere or cylinder.
    s_mm
        Nesting index of the S-filter in mm, which removes shorter waves; default: the smallest one
        of ISO 25178-3 that the images resolve.
    l_mm
        Nesting index of the L-filter in mm, which removes longer waves, the waviness; 0 for none;
        default: the largest one of ISO 25178-3 that fits into the area five times.
    robust
        Give outliers, such as scratches and grains of dust, little weight in form and L-filter.
    scale_percent
        Standard uncertainty of the size of a pixel in percent.
    limits
        File of limits (.toml): tables [[limit]] with parameter, least, most, and perhaps region.
    out
        Folder for parameters.csv (with the uncertainty budget), heights_*.exr and .csv,
        roughness.png, limits.csv and roughness.json; without it, nothing is written.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    wanted = None if limits is None else read_limits(limits)
    areas, profiles, steps = regions(region), lines(line, "--line"), lines(step, "--step")
    if not (areas or profiles or steps):
        areas = [Region("surface", None, None)]
    surface = read_surface(result, scale_sigma=scale_percent / 100, max_pixels=max_pixels)
    scales = Scales(form, s_mm, l_mm, robust)
    made = Result(warnings=surface.notices, inputs=surface.files)
    made.inputs += [one for one in (limits, *(area.mask for area in areas)) if one is not None]
    with Stages() as progress:
        measured = [_area(made, surface, one, scales, progress) for one in areas]
        measured += [
            _along(surface, "profile", name, one, scales, progress) for name, one in profiles
        ]
        measured += [_along(surface, "step", name, one, scales, progress) for name, one in steps]
    resolution = surface.resolution_of(surface.heights_mm)
    metrics = RoughnessMetrics(
        pixel_mm=resolution.pixel_mm,
        lens_blur_px=resolution.blur_px,
        lateral_resolution_mm=resolution.lateral_mm,
        regions=[one.metrics() for one in measured],
    )
    made.summary = [
        f"pixels of {rig.figure(resolution.pixel_mm, 4)} mm, lateral resolution "
        f"{rig.figure(resolution.lateral_mm, 3)} mm"
    ]
    for one in measured:
        made.summary += one.lines()
    judged = []
    if wanted is not None:
        judged = applied(wanted, [(one.name, one.quantities) for one in measured])
        metrics["limits"] = limit_metrics(judged)
        made.summary += [
            f"{answer:10} {place}: {limit}: {text_of(quantity)}"
            for limit, place, quantity, answer in judged
        ]
        if any(answer == "exceeded" for *_, answer in judged):
            made.ok, made.failing_code = False, UNUSABLE
    made.metrics = metrics
    if out is not None:
        claim_folder(out, "roughness.json")
        write_roughness(made, measured, judged, out)
    return made


def _area(
    made: Result, surface: SurfaceInput, area: Region, scales: Scales, progress: rig.Progress
) -> Measured:
    inside = _largest_part(made, surface, area)
    heights = surface.heights_mm
    if area.mask is not None or surface.parts is not None:
        heights = np.where(inside, heights, np.float32(math.nan))
    seen = surface.resolution_of(heights[inside])
    try:
        found = measure_area(heights, inside, seen, scales, surface.errors, on_progress=progress)
    except (acquisition.DataError, calibration.EstimateError) as error:
        raise type(error)(f"region {area.name}: {error}") from error
    rows, columns = bounding_box(inside)
    place = f"{columns.start},{rows.start},{columns.stop - columns.start},{rows.stop - rows.start}"
    heights, scales, pixel = found.heights_mm, found.scales, seen.pixel_mm
    return Measured(area.name, "area", place, heights, found.quantities, scales, pixel)


def _along(
    surface: SurfaceInput,
    kind: Literal["profile", "step"],
    name: str,
    line: Line,
    scales: Scales,
    progress: rig.Progress,
) -> Measured:
    heights = surface.heights_mm
    if surface.parts is not None:
        # Where it leaves the part in which it begins, a line crosses a hole or a jump.
        row, column = (
            int(np.clip(round(at), 0, size - 1))
            for at, size in zip((line.y0, line.x0), heights.shape, strict=True)
        )
        same = surface.parts == surface.parts[row, column]
        heights = np.where(same, heights, np.float32(math.nan))
    try:
        given = heights, line, surface.resolution_of(line.of(heights))
        if kind == "profile":
            found = measure_profile(*given, scales, surface.errors, on_progress=progress)
        else:
            known = surface.known_mm
            found = measure_step(*given, surface.errors, known_mm=known, on_progress=progress)
    except (acquisition.DataError, calibration.EstimateError) as error:
        raise type(error)(f"{kind} {name}: {error}") from error
    values, place, pixel = found.heights_mm, str(line), given[2].pixel_mm
    return Measured(name, kind, place, values, found.quantities, found.scales, pixel)


def _largest_part(made: Result, surface: SurfaceInput, area: Region) -> Bool:
    """Return the known pixels of an area in the largest part of the surface that it contains."""
    asked = area.inside(surface.heights_mm.shape)
    largest: Bool = asked & np.isfinite(surface.heights_mm)
    if area.mask is None and area.rectangle is None:
        asked = largest
    if surface.parts is not None and (largest & (surface.parts >= 0)).any():
        counts = np.bincount(surface.parts[largest & (surface.parts >= 0)])
        largest = largest & (surface.parts == int(counts.argmax()))
    left_out = 1 - np.count_nonzero(largest) / max(int(np.count_nonzero(asked)), 1)
    if left_out > _OTHER_PARTS and largest.any():
        text = (
            f"{left_out:.1%} of region {area.name} have no height, or are in other parts, whose "
            "height relative to the largest one is not known: they were left out"
        )
        made.warnings.append(rig.Notice("roughness-parts", text))
    return largest
