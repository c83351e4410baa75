"""``sgp calibrate flat``: vignetting and response of the pixels from a matte white card."""

from __future__ import annotations

from pathlib import Path

import acquisition
import calibration
import rig
from sgp.cli.console import with_progress
from sgp.cli.options import Gamma, Inputs, LightsInput, OptionalInput, Pixels, Real
from sgp.results import (
    FlatMetrics,
    Result,
    check_output,
    claim_folder,
    complete_provenance,
    figures_of,
    stated,
)
from sgp.rigs import given_lights
from sgp.stages import open_sources


def flat(
    source: Inputs,
    *,
    lights: LightsInput,
    out: Path,
    camera: OptionalInput = None,
    mask: OptionalInput = None,
    height_mm: Real = 0.0,
    gamma: Gamma = "auto",
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Estimate the flat field of camera and lens from a matte white card under near lights.

    The card lies in the working plane and fills the image. It is divided by the light of its LEDs,
    whose intensities, axes and angular falloff are fitted to it, so that vignetting and the
    response of the pixels remain. Give two or more recordings with the card moved or turned between
    them to average the texture of the card. Repeats and dark frames reduce the noise. Give the
    result to other commands with --flat.

    For example:

        sgp calibrate flat card/ --lights lights.json --out flat
        sgp calibrate flat card/ turned/ --lights lights.json --out flat

    Parameters
    ----------
    source
        Sessions or folders of images of the card, with images of all lights.
    lights
        Lights file with positions.
    out
        Folder for flat.json, smooth.exr, pixel.exr and flat.png.
    camera
        Camera file of the images; default: the camera of the session.
    mask
        Mask image of the card; default: the card is found. The mask of the source is not used.
    height_mm
        Height of the card's upper side over the working plane.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Write into an output folder that already contains files.
    """
    given = stated(locals())
    check_output(out, (source, lights, camera, mask), force=force)
    known = given_lights(lights, source)
    sources, files = open_sources(
        source, camera=camera, mask=mask, gamma=gamma, max_pixels=max_pixels
    )
    found = with_progress(calibration.calibrate_flat)(
        sources, known.lights, z_mm=height_mm, mask=None if mask is None else sources[0].mask
    )
    result = Result(
        metrics=_metrics(found),
        warnings=[*found.warnings],
        summary=_lines(found),
        inputs=list(dict.fromkeys([known.file, *files])),
    )
    parameters = given | {"transfer": [one.transfer.record() for one in sources]}
    made_by = complete_provenance("sgp calibrate flat", parameters, result)
    folder = claim_folder(out, "flat.json")
    picture = folder / "flat.png"
    _draw(picture, sources[0], found.flat)
    acquisition.value_files.write_flat(
        folder, found.flat, outputs={"picture": picture.name}, provenance=made_by
    )
    result.outputs = {
        "flat": folder / "flat.json",
        "smooth": folder / "smooth.exr",
        "pixel": folder / "pixel.exr",
        "picture": picture,
    }
    return result


def _metrics(found: calibration.flat.FlatCalibration) -> FlatMetrics:
    flat = found.flat
    smooth = flat.smooth if flat.smooth.ndim == 2 else flat.smooth.mean(axis=2)
    corners = smooth[[0, 0, -1, -1], [0, -1, 0, -1]].tolist()
    noise, lights = flat.pixel_std or 0.0, len(found.lights)
    return figures_of(FlatMetrics, found, flat, corners=corners, pixel_std=noise, lights=lights)


def _lines(found: calibration.flat.FlatCalibration) -> list[str]:
    """Return the block for the terminal: what was found, and how sure."""
    figures = _metrics(found)
    corners = figures["corners"]
    gradient = "its gradient is unknown: the lights have no standard deviations of their positions"
    if figures["gradient_std"] is not None:
        gradient = f"a gradient of {figures['gradient_std']:.2%} (std) may be that of the lights"
    lines = [
        f"flat from {rig.pluralize(figures['frames'], 'frame')} of {figures['lights']} lights, "
        f"the card covers {figures['covered']:.1%} of the image",
        f"  smooth part: corners at {min(corners):.1%} to {max(corners):.1%} of the middle; "
        f"{gradient}",
        f"  pixel part: {figures['prnu']:.2%} among the pixels, std by noise "
        f"{figures['pixel_std']:.2%}",
    ]
    if found.card_std is not None and found.uneven is not None:
        lines.append(
            f"  of the card: texture {found.card_std:.2%} left in the flat, smooth parts differ by "
            f"{found.uneven:.2%}, {rig.pluralize(found.stains, 'pixel')} with stains"
        )
    return [*lines, f"  residual on the card {figures['residual']:.2%}"]


def _draw(path: Path, source: acquisition.Source, flat: acquisition.Flat) -> None:
    from sgp.pictures import (
        histogram_panel,
        pixel_panel,
        smooth_panel,
        source_title,
        write_overview,
    )

    panels = [
        smooth_panel(flat),
        pixel_panel(flat, whole=True),
        pixel_panel(flat, whole=False),
        histogram_panel(flat),
    ]
    write_overview(path, source_title(source, f"flat field: {source.path}"), panels, columns=2)
