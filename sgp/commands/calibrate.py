"""Calibrate lights, camera, sensor and flat field; compare calibrations of lights.

For example:

    sgp calibrate spheres chrome/ --out lights.json
    sgp calibrate sensor card/ --out sensor
    sgp calibrate check before.json after.json --limit-mm 3
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import acquisition
import calibration
import rig as rigs
from rig.arrays import Float32, Float64
from sgp.calibrate import Marks, marks_of
from sgp.cli import options
from sgp.cli.exit import UsageError
from sgp.cli.threads import opencv_threads
from sgp.results import Result, check_file, stated
from sgp.rigs import led_positions, rig_notices, rig_with_positions
from sgp.stages import (
    advise_to_exclude,
    describe_spheres,
    draw_candidates,
    draw_spheres,
    given_radii,
    open_source,
    undivided_images,
    write_calibration,
)


def spheres(
    source: options.Inputs,
    *,
    out: Path,
    radius_mm: tuple[options.Positive, ...] = (),
    camera: options.OptionalInput = None,
    mask: tuple[Path, ...] = (),
    sphere: tuple[str, ...] = (),
    gamma: options.Gamma = "auto",
    flat: options.OptionalInput = None,
    exclude: options.Names = (),
    rig: options.RigOption = None,
    max_pixels: options.Pixels = rigs.MAX_PIXELS,
    force: bool = False,
) -> Result:
    """Estimate lights from their highlights on chrome spheres.

    One sphere gives light directions. Two or more spheres with a camera and a radius give light
    positions. Several recordings of the same lights, with the spheres moved between them, are
    calibrated together: two recordings with one sphere each give positions.

    For example:

        sgp calibrate spheres chrome/ --out lights.json
        sgp calibrate spheres session/ --radius-mm 20 --out lights.json
        sgp calibrate spheres first/ moved/ --radius-mm 20 --out lights.json
        sgp calibrate spheres chrome/ --exclude 7,12-14 --out lights.json

    Parameters
    ----------
    source
        Session or folder of images, one image for each light; short exposure times give sharper
        highlights. Several of them are recordings by the same camera, with the spheres elsewhere.
    out
        lights.json file to write; lights.lp and lights.png (a picture of the result) are written
        to the same folder.
    radius_mm
        Radius of the spheres in mm. If the radii differ, repeat the option for each sphere: in any
        order for spheres that are detected (the larger radius belongs to the larger outline), else
        in the order of --mask or --sphere. For several recordings, give the radii of the set of
        spheres once.
    camera
        Camera file of the images; default: the camera of the session, else that of the focal length
        that the images state in Exif.
    mask
        Mask image of one sphere; may be repeated; default: the mask file of a plain folder of
        images (mask.* or *.mask.*), else the spheres are detected. The mask of any other source
        shows the object and is not used. For several recordings, the number of the recording comes
        first: 2:ball.png.
    sphere
        Rough outline x,y,radius of a sphere in pixels; may be repeated. For several recordings, the
        number of the recording comes first: 2:810,395,120.
    gamma
        Transfer curve of the images: auto, srgb, linear, an exponent such as 2.2, or a file with a
        table; see `sgp normals --help`.
    flat
        Flat field of the camera and its lens, from `sgp calibrate flat`: flat.json or its folder.
    exclude
        Images to leave out, by name or number: L07,L12 or 0-5,8. The number is the one in the name.
        Their lights are not in lights.json. Of several recordings, the images of these lights are
        left out of all. Images that the others contradict (auto) are always left out.
    rig
        Rig file (.toml) whose led_positions_mm the lights are compared with, and which decide
        between a wrong radius and a wrong working distance; default: the configured rig if the
        session was recorded with it.
    max_pixels
        Refuse images with more pixels than this, before decoding them.
    force
        Overwrite existing files.
    """
    given = stated(locals())
    outputs = {"lights": out, "lp": out.with_suffix(".lp"), "picture": out.with_suffix(".png")}
    for path, suffix in zip(outputs.values(), (".json", ".lp", ".png"), strict=True):
        check_file(path, suffix, force=force)
    options.distinct(source)
    if rig is not None:
        rig_with_positions(rig)  # a mistake is reported before the images are read
    marks = marks_of([str(path) for path in mask], sphere, len(source))
    recordings, files = _open(
        source,
        marks,
        camera=camera,
        gamma=gamma,
        flat=flat,
        without=options.named(exclude),
        max_pixels=max_pixels,
    )
    calibration.spheres.check_recordings([one.source for one in recordings])
    first = recordings[0].source
    places_mm = led_positions(rig, first.setup.rig)
    candidates = out.with_name(f"{out.stem}-candidates.png")
    estimate = calibration.spheres.record_setup(
        _estimate(recordings, radius_mm, places_mm, candidates), *[one.source for one in recordings]
    )
    result = describe_spheres(estimate, source)
    result.outputs = outputs
    result.warnings = [
        *[notice for one in recordings for notice in one.notices],
        *estimate.warnings,
        *rig_notices(estimate.lights, rig, first.setup.rig),
    ]
    result.inputs = files
    parameters = given | {"transfer": first.transfer.record()}
    write_calibration(out, estimate.lights, "sgp calibrate spheres", parameters, result)
    acquisition.write_lights(outputs["lp"], estimate.lights)
    shown = [(one.source, one.brightest) for one in recordings]
    draw_spheres(outputs["picture"], shown, estimate)
    return result


class _Recording:
    """One of the recordings; its images are read once, and not kept."""

    brightest: Float32

    def __init__(self, source: acquisition.Source, marks: Marks) -> None:
        self.source = source
        self.masks = list(marks.masks)
        self.circles = list(marks.circles)
        self.notices: list[rigs.Notice] = list(source.warnings)
        if source.mask_path is not None and source.mask_origin == "folder" and not marks.circles:
            self.masks = [source.mask_path]

    def read(self) -> calibration.Stack:
        """Read the images; keep the brightest value of each pixel for the picture."""
        largest = max(self.source.size)
        if any(radius > largest for _, _, radius in self.circles):
            raise UsageError(
                f"--sphere: the radius must not exceed the size of the images, {largest} pixels"
            )
        stack = undivided_images(self.source)
        self.notices += stack.warnings
        self.brightest = stack.brightest
        return stack

    def mask_images(self) -> list[Float64]:
        return [acquisition.pixels.read_mask_shares(path, self.source.size) for path in self.masks]


def _open(
    paths: Sequence[Path], marks: Sequence[Marks], **given: Any
) -> tuple[list[_Recording], list[Path]]:
    """Open all recordings as `open_source` does; return them and their files, for hashing."""
    recordings, files = [], list[Path]()
    for path, mark in zip(paths, marks, strict=True):
        # A folder may contain one mask for each sphere; giving one spares the reader the choice.
        first, others = (mark.masks[0], mark.masks[1:]) if mark.masks else (None, ())
        opened, read = open_source(path, mask=first, others=others, **given)
        recordings.append(_Recording(opened, mark))
        files += read
    return recordings, list(dict.fromkeys(files))


def _estimate(
    recordings: Sequence[_Recording],
    radius_mm: Sequence[float],
    places_mm: Mapping[str, Sequence[float]],
    picture: Path,
) -> calibration.SphereCalibration:
    """Calibrate from one recording, or from all of them together; draw candidates if it fails."""
    sources = [one.source for one in recordings if one.source.camera is not None]
    sources.sort(key=lambda source: source.camera_nominal)
    known: dict[str, Any] = {
        "camera": sources[0].camera if sources else None,
        "radius_mm": given_radii(radius_mm),
        "led_positions_mm": places_mm,
    }
    stack: calibration.Stack | None = None
    try:
        with opencv_threads(1):
            if len(recordings) > 1:
                return calibration.calibrate_moved_spheres(
                    (one.read() for one in recordings),
                    names=[str(one.source.path) for one in recordings],
                    masks=[one.mask_images() for one in recordings],
                    circles=[one.circles for one in recordings],
                    **known,
                )
            stack = recordings[0].read()
            return calibration.calibrate_spheres(
                stack, masks=recordings[0].mask_images(), circles=recordings[0].circles, **known
            )
    except calibration.EstimateError as error:
        advise_to_exclude(error)
        for one in recordings:
            _explain_masks(error, one.source, one.masks)
        # Spheres were not searched for if too many images are blank: a mark would not help.
        blank = error.lights and not error.spheres
        if stack is not None and not recordings[0].masks and not blank:
            _draw_candidates(error, recordings[0], stack, picture)
        raise


def _draw_candidates(
    error: calibration.EstimateError, recording: _Recording, stack: calibration.Stack, picture: Path
) -> None:
    """Write a picture of what may be a sphere, and add a note about it to an error.

    Spheres that were found are not among them: another mark would change nothing.
    """
    candidates = [
        candidate
        for candidate in calibration.spheres.sphere_candidates(
            stack, camera=recording.source.camera
        )
        if not any(_within(candidate.circle_px, sphere) for sphere in error.spheres)
    ]
    if not candidates or (error.spheres and not candidates[0].lights):
        return
    draw_candidates(picture, recording.source, recording.brightest, candidates)
    count = rigs.pluralize(len(candidates), "candidate")
    note = f"{picture} shows {count} and why they are not used"
    # A person who gave a circle has decided where the sphere is.
    if candidates[0].lights and not recording.circles:
        x, y, radius = candidates[0].circle_px
        note += f"; if number 1 is a mirror sphere, add --sphere {x:.0f},{y:.0f},{radius:.0f}"
    error.add_note(note)


def _within(circle: tuple[float, float, float], sphere: tuple[float, float, float]) -> bool:
    """Return whether the centre of one of two circles (x, y, radius) is inside the other."""
    apart = np.hypot(circle[0] - sphere[0], circle[1] - sphere[1])
    return bool(apart < max(circle[2], sphere[2]))


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
