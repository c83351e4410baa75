"""Lights from mirror spheres: what commands read, write, draw and report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import acquisition
import calibration
import rig
from rig.arrays import Float32
from sgp.cli.console import with_progress
from sgp.cli.threads import opencv_threads
from sgp.results import Result, SpheresMetrics, complete_provenance


@dataclass(frozen=True, eq=False)
class SphereLights:
    """Lights from spheres next to the object.

    Parameters
    ----------
    source
        The complete recording.
    estimate
        The lights and the quality of the fit.
    lights
        The same lights with the intensities, axes and angular falloff of the recording.
    brightest
        ``(H, W)`` float32, the brightest value of each pixel.
    warnings
        Doubts about the lights.
    """

    source: acquisition.Source
    estimate: calibration.SphereCalibration
    lights: acquisition.Lights
    brightest: Float32
    warnings: tuple[rig.Notice, ...]


def light_by_spheres(
    source: acquisition.Source,
    radius_mm: Sequence[float],
    places_mm: Mapping[str, Sequence[float]],
    *,
    follow: bool,
) -> tuple[acquisition.Source, SphereLights]:
    """Estimate the lights of a recording from spheres next to its object.

    Parameters
    ----------
    source
        The complete recording.
    radius_mm
        Radii of the spheres; empty if they are not known.
    places_mm
        Positions of LEDs that are known independently, by their ids; may be empty.
    follow
        Follow a camera that drifted.

    Raises
    ------
    DataError, EstimateError
        As `calibration.calibrate_spheres`.
    """
    stack = undivided_images(source)
    try:
        with opencv_threads(1):
            estimate = calibration.calibrate_spheres(
                stack,
                camera=source.camera,
                radius_mm=given_radii(radius_mm),
                led_positions_mm=places_mm,
                follow=follow,
            )
    except calibration.EstimateError as error:
        advise_to_exclude(error)
        raise
    estimate = calibration.spheres.record_setup(estimate, source)
    lit = calibration.apply_spheres(source, estimate)
    lights = estimate.lights if lit.lights is None else lit.lights
    if lit.shifts_px:  # the picture of the spheres is that of images which are moved back
        stack = undivided_images(lit)
    return lit, SphereLights(source, estimate, lights, stack.brightest, estimate.warnings)


def add_sphere_lights(
    result: Result, folder: Path, seen: SphereLights | None, command: str
) -> None:
    """Write lights.json and lights.png into the folder of a result, and report them there."""
    if seen is None:
        return
    described = describe_spheres(seen.estimate)
    described.inputs = result.inputs
    described.warnings = list(seen.warnings)
    outputs = {"lights": folder / "lights.json", "lights_png": folder / "lights.png"}
    if "lights" in result.outputs:  # with estimated strengths
        del outputs["lights"]
    else:
        write_calibration(
            outputs["lights"], seen.lights, command, {"source": seen.source.path}, described
        )
    draw_spheres(outputs["lights_png"], [(seen.source, seen.brightest)], seen.estimate)
    result.outputs |= outputs
    result.warnings = [*described.warnings, *result.warnings]
    result.summary = [*described.summary, *result.summary]


def advise_to_exclude(error: calibration.EstimateError) -> None:
    """Add a note to an error that some images cause: how to leave them out."""
    if error.lights:
        names = ",".join(error.lights)
        error.add_note(f"to calibrate the other lights, add --exclude {names}")


def given_radii(radius_mm: Sequence[float]) -> float | Sequence[float] | None:
    """Return what `calibrate_spheres` expects: no radius, one for all, or one for each."""
    if not radius_mm:
        return None
    return radius_mm[0] if len(radius_mm) == 1 else radius_mm


def undivided_images(source: acquisition.Source) -> calibration.Stack:
    """Read images as recorded, without dividing by the light intensities of the source."""
    return with_progress(calibration.raw_stack)(replace(source, lights=None))


def write_calibration(
    out: Path, lights: acquisition.Lights, command: str, parameters: dict[str, Any], result: Result
) -> None:
    """Write lights.json including its record, because the file is passed on without its folder."""
    made_by = complete_provenance(command, parameters, result)
    acquisition.write_lights(out, lights, provenance=made_by)


def describe_spheres(
    estimate: calibration.SphereCalibration, recordings: Sequence[Path] = ()
) -> Result:
    """Return the figures and lines about a calibration; ``recordings`` if there are several."""
    several = len(recordings) > 1
    residual = estimate.residuals_deg[np.isfinite(estimate.residuals_deg)]
    metrics: SpheresMetrics = {
        "lights": len(estimate.lights),
        "near": estimate.lights.near,
        "spheres": [
            {
                "centre_px": sphere.outline.centre_px,
                "semi_axes_px": sphere.outline.semi_axes_px,
                "centre_mm": sphere.centre_mm,
                "radius_mm": sphere.radius_mm,
                "coverage": sphere.coverage,
                "rms_px": sphere.rms_px,
            }
            for sphere in estimate.spheres
        ],
        "residual_deg": float(np.mean(residual)) if len(residual) else None,
    }
    if estimate.pixel_mm is not None and estimate.pixel_sigma_mm is not None:
        metrics["pixel_mm"] = estimate.pixel_mm
        metrics["pixel_sigma_mm"] = estimate.pixel_sigma_mm
    for figures, sphere in zip(metrics["spheres"], estimate.spheres, strict=True):
        if several:
            figures["recording"] = str(recordings[sphere.recording])
    result = Result(metrics=metrics)
    kind = "light position" if estimate.lights.near else "light direction"
    balls = rig.pluralize(len(estimate.spheres), "sphere")
    text = f"{rig.pluralize(len(estimate.lights), kind)} from {balls}"
    result.summary = [f"{text} in {len(recordings)} recordings" if several else text]
    for sphere in estimate.spheres:
        (x, y), (a, b) = sphere.outline.centre_px, sphere.outline.semi_axes_px
        line = f"  sphere at ({x:.1f}, {y:.1f}) px, semi-axes {a:.1f} x {b:.1f} px"
        result.summary.append(f"{line}, {recordings[sphere.recording]}" if several else line)
    if len(residual):
        result.summary.append(f"spheres agree to {np.mean(residual):.2f} deg on average")
    result.summary += _say_errors(estimate.lights)
    return result


def _say_errors(lights: acquisition.Lights) -> list[str]:
    """Return a line with the standard deviations of the lights along their longest axes."""
    from sgp.pictures import longest_sigmas

    sigma = longest_sigmas(lights)
    if sigma is None:
        return []
    unit = "mm" if lights.near else "deg"
    if not lights.near:
        sigma = np.degrees(sigma)
    usual, most = rig.figure(np.median(sigma)), rig.figure(sigma.max())
    return [f"standard deviation of a light: {usual} {unit} (median), {most} {unit} (largest)"]


def draw_spheres(
    path: Path,
    shown: Sequence[tuple[acquisition.Source, Float32]],
    estimate: calibration.SphereCalibration,
) -> None:
    """Write a picture of the spheres and lights; ``shown`` has the brightest value of each pixel.

    There is one such ``(H, W)`` for each recording.
    """
    from sgp.pictures import (
        ellipsoids_panel,
        lights_panel,
        residuals_panel,
        source_title,
        spheres_panel,
        write_overview,
    )

    title = "spheres and highlights"
    panels = [
        spheres_panel(
            f"{title}: {source.path}" if len(shown) > 1 else title, brightest, estimate, k
        )
        for k, (source, brightest) in enumerate(shown)
    ]
    panels.append(lights_panel("lights, rings in degrees from the viewing axis", estimate.lights))
    errors = [ellipsoids_panel(estimate.lights), residuals_panel(estimate.lights)]
    panels += [panel for panel in errors if panel is not None]
    names = ", ".join(str(source.path) for source, _ in shown)
    write_overview(path, source_title(shown[0][0], names), panels, columns=2)


def draw_candidates(
    path: Path,
    source: acquisition.Source,
    brightest: Float32,
    candidates: Sequence[calibration.spheres.SphereCandidate],
) -> None:
    """Write a picture of numbered circles that may be spheres, and why each was not used."""
    from sgp.pictures import candidates_panel, reasons_panel, source_title, write_overview

    panels = [candidates_panel(brightest, candidates), reasons_panel(candidates)]
    write_overview(path, source_title(source, str(source.path)), panels, columns=2)
