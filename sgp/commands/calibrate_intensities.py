"""``sgp calibrate intensities``: strengths of the lights from a matte card or ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

import acquisition
import calibration
import rig
from rig.arrays import Bool, Float64
from sgp.cli import options
from sgp.cli.console import with_progress
from sgp.cli.exit import UsageError
from sgp.results import IntensitiesMetrics, Result, check_file, stated
from sgp.rigs import given_lights
from sgp.stages import open_source, write_calibration

# Names of lights that a line may list.
_LISTED = 8


def intensities(
    source: options.Inputs,
    *,
    lights: options.LightsInput,
    out: Path,
    camera: options.OptionalInput = None,
    mask: options.OptionalInput = None,
    height_mm: tuple[options.Real, ...] = (),
    ball: str | None = None,
    radius_mm: options.Positive | None = None,
    channel: Literal["gray", "rgb"] = "gray",
    even: bool = False,
    gamma: options.Gamma = "auto",
    flat: options.OptionalInput = None,
    max_pixels: options.Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    r"""Estimate intensities, axes and angular falloff of the lights from a matte card or ball.

    The card is in the working plane, or parallel to it at --height-mm. It may have any pattern, and
    chrome spheres may be on it, so the recording from which the positions were estimated can be
    used. Recordings of cards at several heights are fitted together. Intensities are relative to
    their mean over the lights, in each channel.

    For example:

        sgp calibrate intensities session/ --lights lights.json --out card.json
        sgp calibrate intensities s/ --lights p.json --channel rgb --out l.json
        sgp calibrate intensities a/ b/ --height-mm 0 --height-mm 20 \
            --lights p.json --out l.json
        sgp calibrate intensities s/ --ball 320,255,90 --radius-mm 40 \
            --lights p.json --out l.json

    Parameters
    ----------
    source
        Sessions or folders of images of the card, one image for each light.
    lights
        Lights file with positions.
    out
        lights.json file to write.
    camera
        Camera file of the images; default: the camera of the session.
    mask
        Mask image of the card; default: the complete frame, with everything except the card removed
        as outliers. The mask of the source is not used, because it shows an object or a sphere.
    height_mm
        Height of the card's upper side over the working plane; once for each source; default: 0.
    ball
        Outline x,y,radius of a matte ball in pixels, instead of a card; requires --radius-mm.
    radius_mm
        Radius of the matte ball in mm.
    channel
        gray, or rgb for an intensity in each colour.
    even
        State that the card has the same albedo everywhere, to determine the vignetting of the lens.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    flat
        Flat field of the camera and its lens, from `sgp calibrate flat`: flat.json or its folder.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite an existing file.
    """
    given = stated(locals())
    check_file(out, ".json", force=force)
    options.distinct(source)
    if len(height_mm) not in (0, len(source)):
        raise UsageError(
            f"--height-mm is given {rig.pluralize(len(height_mm), 'time')} for "
            f"{rig.pluralize(len(source), 'source')}: give it once for each source"
        )
    if (ball is None) != (radius_mm is None):
        raise UsageError("a matte ball needs both --ball x,y,radius and --radius-mm")
    if ball is not None and (height_mm or mask is not None or even):
        raise UsageError("--height-mm, --mask and --even describe a card: do not give --ball")
    outline = () if ball is None else tuple(options.numbers("--ball", ball, 3))
    known = given_lights(lights, source)
    positions = known.lights
    surfaces: list[calibration.MatteSurface] = []
    files, warnings, curves = [known.file], [*positions.warnings], list[dict[str, Any]]()
    for path, height in zip(source, height_mm or (0.0,) * len(source), strict=True):
        opened, read = open_source(
            path, camera=camera, mask=mask, gamma=gamma, flat=flat, max_pixels=max_pixels
        )
        model = opened.calibrated_camera
        if model is None:
            raise acquisition.DataError(
                f"{path}: the camera of these images is not calibrated: give --camera"
            )
        stack = with_progress(calibration.linear_stack)(
            replace(opened, lights=None), channel=channel
        )
        order, by_name = positions.match(stack.ids)
        if not by_name:
            text = "matched to the images by number or order, not by name"
            warnings.append(rig.Notice("lights-matched-by-order", text, str(lights)))
        # The images of each recording are put into the order of the lights of the first.
        if not surfaces:
            first = order
        values = stack.values
        if order != first:
            if sorted(order) != sorted(first):
                raise acquisition.DataError(f"{path}: the recordings show different lights")
            values = values[[order.index(light) for light in first]]
        if outline:
            x, y, radius = outline
            made = calibration.MatteSurface.ball(values, model, (x, y, radius), radius_mm or 0.0)
        else:
            card = opened.mask if mask is not None else None
            made = calibration.MatteSurface.card(values, model, z_mm=height, mask=card)
        surfaces.append(made)
        files += read
        warnings += [
            *opened.warnings,
            *acquisition.source.setup_notices(replace(opened, lights=positions)),
            *stack.warnings,
        ]
        curves.append(opened.transfer.record())
    estimate = calibration.calibrate_intensities(surfaces, positions.take(first), even=even)
    result = Result(
        outputs={"lights": out},
        metrics=_metrics(estimate, channel),
        warnings=[*warnings, *estimate.warnings],
        summary=_lines(estimate),
        inputs=list(dict.fromkeys(files)),
    )
    parameters = given | {"transfer": curves[0] if len(curves) == 1 else curves}
    write_calibration(out, estimate.lights, "sgp calibrate intensities", parameters, result)
    return result


def _metrics(
    estimate: calibration.intensities.IntensityCalibration, channel: str
) -> IntensitiesMetrics:
    lights, errors = estimate.lights, estimate.lights.errors or acquisition.LightErrors()
    strength = np.asarray(lights.intensities)
    metrics: IntensitiesMetrics = {
        "intensities": strength.mean(axis=1).tolist(),
        "intensity_std": np.asarray(errors.intensity_std).max(axis=1).tolist(),
        "mu": estimate.mu,
        "mu_each": np.asarray(lights.mu).tolist(),
        "mu_std": np.asarray(errors.mu_std).tolist(),
        "mu_own": estimate.own_mu.tolist(),
        "mu_spread": estimate.mu_spread,
        "axis_std_deg": np.asarray(errors.axis_std_deg).tolist(),
        "axis_own": estimate.own_axis.tolist(),
        "axis_spread_deg": estimate.axis_spread_deg,
        "residual": estimate.residual,
        "pixels": estimate.pixels,
    }
    if channel == "rgb":
        metrics["intensities_rgb"] = [(r, g, b) for r, g, b in strength.tolist()]
    if estimate.vignetting is not None:
        metrics["vignetting_corner"] = estimate.vignetting.corner
        metrics["vignetting_corner_std"] = estimate.vignetting.corner_std
    return metrics


def _lines(estimate: calibration.intensities.IntensityCalibration) -> list[str]:
    """Return the block for the terminal: what was found, how sure, and what is shared."""
    lights, errors = estimate.lights, estimate.lights.errors or acquisition.LightErrors()
    strength, mu = np.asarray(lights.intensities), np.asarray(lights.mu)
    percent = 100 * np.asarray(errors.intensity_std) / strength
    lines = [
        f"{rig.pluralize(len(lights), 'light')}, intensities {strength.min():.2f} to "
        f"{strength.max():.2f} of their mean, std {_range(percent, 2)} %",
        f"  mu {_range(mu, 2)}, std {_range(np.asarray(errors.mu_std), 3)}; "
        + _shared(estimate.own_mu, lights.ids, "own", "common value"),
        f"  axis std {_range(np.asarray(errors.axis_std_deg), 2)} deg; "
        + _shared(estimate.own_axis, lights.ids, "own", "given axis"),
    ]
    vignetting = estimate.vignetting
    if errors.covariances is None:
        lines.append("  std without errors of the positions: the lights file does not state them")
    if vignetting is None:
        lines.append("  vignetting cannot be separated from the card's albedo without --even")
    else:
        lines.append(
            f"  vignetting: corners at {vignetting.corner:.2%} of the middle, "
            f"std {vignetting.corner_std:.2%}"
        )
    return [*lines, f"  residual on the card {estimate.residual:.2%}, {estimate.pixels} pixels"]


def _shared(own: Bool, ids: Sequence[str], its: str, common: str) -> str:
    """Return which lights have their own value, and which the common one."""
    if own.all():
        return f"{its} value for each light"
    if not own.any():
        return f"{common} for all lights"
    names = [name for name, has in zip(ids, own, strict=True) if not has]
    shown = ", ".join(names) if len(names) <= _LISTED else f"{len(names)} of {len(own)} lights"
    return f"{common} for {shown}"


def _range(values: Float64, digits: int) -> str:
    low, high = f"{values.min():.{digits}f}", f"{values.max():.{digits}f}"
    return low if low == high else f"{low} to {high}"
