"""``sgp calibrate spheres``: directions or positions of the lights."""

from __future__ import annotations

from pathlib import Path

import acquisition
import calibration
import rig as rigs
from sgp._exit import UsageError
from sgp._options import Gamma, Input, OptionalInput, Pixels, Positive, RigOption, numbers
from sgp._output import check_file
from sgp._result import Result
from sgp._rig_lights import led_positions, rig_notices, rig_with_positions
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
    rig: RigOption = None,
    max_pixels: Pixels = rigs.MAX_PIXELS,
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
    rig
        Rig file (.toml) whose led_positions_mm the lights are compared with, and which decide
        between a wrong radius and a wrong working distance; default: the configured rig if the
        session was recorded with it.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite existing files.
    """
    outputs = {"lights": out, "lp": out.with_suffix(".lp"), "picture": out.with_suffix(".png")}
    for path, suffix in zip(outputs.values(), (".json", ".lp", ".png"), strict=True):
        check_file(path, suffix, force=force)
    if rig is not None:
        rig_with_positions(rig)  # a mistake is reported before the images are read
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
            led_positions_mm=led_positions(rig, opened.setup.rig),
        )
    except calibration.EstimateError as error:
        _explain_masks(error, opened, marked)
        raise
    estimate = calibration.record_setup(estimate, opened)
    result = describe_spheres(estimate)
    result.outputs = outputs
    result.warnings = [
        *opened.warnings,
        *stack.warnings,
        *estimate.warnings,
        *rig_notices(estimate.lights, rig, opened.setup.rig),
    ]
    result.inputs = files
    parameters = {
        "source": source,
        "radius_mm": radius_mm,
        "camera": camera,
        "mask": mask,
        "sphere": sphere,
        "gamma": gamma,
        "rig": rig,
        "transfer": opened.transfer.record(),
    }
    write_calibration(out, estimate.lights, "sgp calibrate spheres", parameters, result)
    acquisition.write_lights(outputs["lp"], estimate.lights)

    draw_spheres(outputs["picture"], opened, stack.values, estimate)
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
