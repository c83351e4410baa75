"""``sgp calibrate``: positions and intensities of the lights."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import acquisition
import calibration
import rig
from sgp._exit import UsageError
from sgp._metrics import IntensitiesMetrics
from sgp._options import Gamma, Input, OptionalInput, Pixels, Positive, numbers
from sgp._output import check_file
from sgp._result import Result
from sgp._spheres import (
    describe_spheres,
    draw_spheres,
    given_radii,
    undivided_stack,
    write_calibration,
)
from sgp._stages import open_source


def spheres(
    source: Input,
    *,
    out: Path,
    radius_mm: tuple[Positive, ...] = (),
    camera: OptionalInput = None,
    mask: tuple[Path, ...] = (),
    sphere: tuple[str, ...] = (),
    gamma: Gamma = "auto",
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Estimate lights from their highlights on chrome spheres.

    One sphere gives light directions. Two or more spheres with a camera and a radius give light
    positions.

    For example:

        sgp calibrate spheres chrome/ --out lights.json
        sgp calibrate spheres session/ --radius-mm 20 --out lights.json

    Parameters
    ----------
    source
        Session or folder of images, one image for each light; short exposure times give sharper
        highlights.
    out
        lights.json file to write; lights.lp and lights.png (a picture of the result) are written
        to the same folder.
    radius_mm
        Radius of the spheres in mm. If the radii differ, repeat the option for each sphere: in any
        order for spheres that are detected (the larger radius belongs to the larger outline), else
        in the order of --mask or --sphere.
    camera
        Camera file of the images; default: the camera of the session.
    mask
        Mask image of one sphere; may be repeated; default: the mask file of a plain folder of
        images (mask.* or *.mask.*), else the spheres are detected. The mask of any other source
        shows the object and is not used.
    sphere
        Rough outline x,y,radius of a sphere in pixels; may be repeated.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite existing files.
    """
    outputs = {"lights": out, "lp": out.with_suffix(".lp"), "picture": out.with_suffix(".png")}
    for path, suffix in zip(outputs.values(), (".json", ".lp", ".png"), strict=True):
        check_file(path, suffix, force=force)
    if mask and sphere:
        raise UsageError("--mask and --sphere both give the outlines of the spheres: give only one")
    outlines = [(x, y, r) for x, y, r in (numbers("--sphere", text, 3) for text in sphere)]
    # A folder may contain one mask for each sphere; giving one spares the reader the choice.
    first, others = (mask[0], mask[1:]) if mask else (None, ())
    opened, files = open_source(
        source, camera=camera, mask=first, gamma=gamma, others=others, max_pixels=max_pixels
    )
    stack = undivided_stack(opened)
    largest = max(stack.values.shape[1:])
    if any(radius > largest for _, _, radius in outlines):
        raise UsageError(
            f"--sphere: the radius must not exceed the size of the images, {largest} pixels"
        )
    marked = list(mask)
    if opened.mask_path is not None and opened.mask_origin == "folder" and not outlines:
        marked = [opened.mask_path]
    try:
        estimate = calibration.calibrate_spheres(
            stack,
            masks=[acquisition.read_mask_shares(path, stack.values.shape[1:]) for path in marked],
            circles=outlines,
            camera=opened.camera,
            radius_mm=given_radii(radius_mm),
        )
    except calibration.EstimateError as error:
        _explain_masks(error, opened, marked)
        raise
    result = describe_spheres(estimate)
    result.outputs = outputs
    result.warnings = [*opened.warnings, *stack.warnings, *estimate.warnings]
    result.inputs = files
    parameters = {
        "source": source,
        "radius_mm": radius_mm,
        "camera": camera,
        "mask": mask,
        "sphere": sphere,
        "gamma": gamma,
        "transfer": opened.transfer.record(),
    }
    write_calibration(out, estimate.lights, "sgp calibrate spheres", parameters, result)
    acquisition.write_lights(outputs["lp"], estimate.lights)

    draw_spheres(outputs["picture"], opened, stack.values, estimate)
    return result


def intensities(
    source: Input,
    *,
    lights: Input,
    out: Path,
    camera: OptionalInput = None,
    mask: OptionalInput = None,
    gamma: Gamma = "auto",
    max_pixels: Pixels = rig.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Estimate the intensities of the lights, and their angular falloff, from a matte card.

    The card is in the working plane. Chrome spheres may be on it, so the recording from which the
    positions were estimated can be used.

    For example:

        sgp calibrate intensities session/ --lights lights.json --out card.json

    Parameters
    ----------
    source
        Session or folder of images of the card, one image for each light.
    lights
        Lights file with positions.
    out
        lights.json file to write.
    camera
        Camera file of the images; default: the camera of the session.
    mask
        Mask image of the card; default: the complete frame, with everything except the card removed
        as outliers. The mask of the source is not used, because it shows an object or a sphere.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite an existing file.
    """
    check_file(out, ".json", force=force)
    opened, files = open_source(
        source, camera=camera, mask=mask, gamma=gamma, max_pixels=max_pixels
    )
    if opened.camera is None:
        raise acquisition.DataError(
            f"{source}: the camera of these images is not known: give --camera"
        )
    stack = undivided_stack(opened)
    positions = acquisition.read_lights(lights)
    order, by_name = positions.match(stack.ids)
    by_order = []
    if not by_name:
        text = "matched to the images by order, not by name"
        by_order.append(rig.Notice("lights-matched-by-order", text, str(lights)))
    card = np.ones(stack.values.shape[1:], np.bool_)
    if mask is not None and opened.mask is not None:
        card = opened.mask
    estimate = calibration.calibrate_intensities(
        stack.values, positions.take(order), opened.camera.points_on_plane(), card
    )
    strength = np.asarray(estimate.lights.intensities)[:, 0]
    metrics: IntensitiesMetrics = {
        "intensities": strength.tolist(),
        "mu": estimate.mu,
        "residual": estimate.residual,
        "pixels": estimate.pixels,
    }
    result = Result(
        outputs={"lights": out},
        metrics=metrics,
        warnings=[*opened.warnings, *stack.warnings, *by_order, *estimate.warnings],
        summary=[
            f"{rig.pluralize(len(strength), 'light')}, intensities {strength.min():.2f} to "
            f"{strength.max():.2f} of their mean, mu {estimate.mu:.2f}; "
            f"residual on the card {estimate.residual:.1%}"
        ],
        inputs=[*files, lights],
    )
    parameters = {
        "source": source,
        "lights": lights,
        "camera": camera,
        "mask": mask,
        "gamma": gamma,
        "transfer": opened.transfer.record(),
    }
    write_calibration(out, estimate.lights, "sgp calibrate intensities", parameters, result)
    return result


def _explain_masks(
    error: calibration.EstimateError, source: acquisition.Source, marked: list[Path]
) -> None:
    """Add a note to an error about a mask that was found and used, or found and not used."""
    if marked and source.mask_origin == "folder":
        error.add_note(
            f"{marked[0]} was used as the mask of a sphere: if it shows an object, move it out of "
            "the folder"
        )
    elif not marked and source.mask_origin == "recording":
        error.add_note(
            f"{source.mask_path} was not used, because it shows the object: if it shows a sphere, "
            "give it with --mask"
        )
