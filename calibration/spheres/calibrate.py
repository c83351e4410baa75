"""Calibration of light directions or positions from mirror spheres, in one or more recordings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from acquisition import CameraModel, DataError
from calibration._errors import EstimateError
from calibration.radiance.stack import Images, Stack
from calibration.spheres.judge.input_tests import known_places
from calibration.spheres.outline.outline_noise import cone_of
from calibration.spheres.outline.sphere_image import SphereImage, circles_of
from calibration.spheres.position_calibration import positioned_lights
from calibration.spheres.propose.sphere_marks import Mask
from calibration.spheres.recording import Circle, SeenSpheres, named_stack, seen_in
from calibration.spheres.solve.average_directions import orthographic_lights, perspective_lights
from calibration.spheres.solve.ball_scale import pixel_size
from calibration.spheres.solve.lost_images import lost_lights
from calibration.spheres.solve.sphere_calibration import SeenTogether, SphereCalibration
from calibration.spheres.solve.sphere_positions import off_the_plane, one_off_the_plane, place
from calibration.spheres.spheres_beside_object import light_difference
from rig import Notice, pluralize
from rig.arrays import Float64


def calibrate_spheres(
    stack: Stack | Images,
    *,
    masks: Sequence[Mask] | None = None,
    circles: Sequence[Circle] | None = None,
    camera: CameraModel | None = None,
    radius_mm: float | Sequence[float] | None = None,
    led_positions_mm: Mapping[str, Sequence[float]] | None = None,
    follow: bool = False,
) -> SphereCalibration:
    """Estimate lights from their highlights on mirror spheres.

    Without a camera, an orthographic view is assumed; for a near light and one sphere the error is
    a few degrees. With a camera, the viewing cone of each sphere is used, which requires no radius
    for directions. With a working distance, a radius and two or more spheres, the lights have
    positions. Without one, a radius gives the size of a pixel.

    Parameters
    ----------
    stack
        One linear image per light, as returned by `raw_stack` (which takes the least memory) or
        `linear_stack`, or ``(N, H, W[, 3])`` values of lights ``L00``..., 1 at the white level of
        the longest exposure, NaN where saturated.
        If brackets are merged into the stack, unsaturated highlights are values far above 1.
    masks
        One or more masks, ``(H, W)`` bool or 0..1; each connected region is a sphere. The mask of a
        `Source` shows its object; it marks spheres only if `Source.mask_origin` is ``given`` or
        ``folder``.
    circles
        Approximate circles (x, y, radius) in pixels, which are refined in the images; their
        outlines may be wrong by 4 px and by a tenth of the radius. Without masks and circles the
        spheres are searched for; with a camera and a radius, only spheres that have the right size
        if they are close to the working plane. A sphere that was found is left out, with a warning,
        if its size differs, its outline is much less sharp than that of the others, or most of its
        highlights disagree with the others.
    camera
        Camera model; positions require its working distance.
    radius_mm
        Radius of the spheres, or one radius for each in the order of masks or circles. For spheres
        that were searched for, larger radii are assigned to larger outlines.
    led_positions_mm
        Positions of LEDs that are known independently, by the ids of the lights, for example from
        the rig file: x, y, z in mm in the house frame. They do not enter the lights. If the images
        contradict the radius or the working distance, they decide which of the two is wrong.
    follow
        If the spheres are not at one place in all images, follow a camera that drifted, by what is
        the same in all images, then by the outlines of the spheres. The images must not turn.

    Returns
    -------
    SphereCalibration
        Lights and quality of the fit. A light is left out, with a notice that names it, if its
        image is black or saturated, shows the spheres elsewhere than the other images, or shows no
        highlight. Then, where the lights have directions, those are left out that no highlight
        determines to 10 degrees. Each of the two steps must leave 85 % of its lights.

    Raises
    ------
    DataError
        If shapes or radii are inconsistent, the camera does not fit the images, or both masks and
        circles are given.
    EstimateError
        If no sphere is found, the edges near a circle do not determine an outline, less than 85 %
        of the lights are left, or a light is visible on fewer than two spheres although positions
        are requested. The message names the lights or the spheres.

    Examples
    --------
    >>> from calibration import calibrate_spheres
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("spheres", width=160, height=128, leds=3))
    >>> masks = list(rendering.truth.sphere_masks)
    >>> calibrate_spheres(rendering.planes, masks=masks).lights
    Lights(3 directions, L00 to L02)
    """
    radii = None if radius_mm is None else _radii(radius_mm)
    seen = seen_in(stack, masks, circles, camera, radii, follow=follow)
    found = _calibrate([seen], ("",), camera, led_positions_mm)
    if seen.shifts_px is None:
        return found
    shifts = zip(seen.names, seen.shifts_px.tolist(), strict=True)
    return replace(found, shifts_px={name: (right, down) for name, (right, down) in shifts})


def calibrate_moved_spheres(
    stacks: Iterable[Stack | Images],
    *,
    names: Sequence[str] = (),
    masks: Sequence[Sequence[Mask] | None] = (),
    circles: Sequence[Sequence[Circle] | None] = (),
    camera: CameraModel | None = None,
    radius_mm: float | Sequence[float] | None = None,
    led_positions_mm: Mapping[str, Sequence[float]] | None = None,
) -> SphereCalibration:
    """Estimate lights from several recordings of the same lights, with the spheres moved between.

    A sphere that was moved counts as another sphere: all lights and all sphere centres of all
    recordings are refined together. So two recordings with one sphere each give positions. Camera
    and lights must not move; see `check_recordings`.

    Parameters
    ----------
    stacks
        Two or more recordings; each is as in `calibrate_spheres`, with the same size and the same
        names of lights, in any order. They are used one after the other, so that a generator needs
        the memory of one recording only.
    names
        A name for each recording, for messages. Default: ``recording 1``, ``recording 2``...
    masks, circles
        For each recording None, or its masks or circles, as in `calibrate_spheres`. Spheres of
        recordings without them are searched for. Default: search in all recordings.
    camera
        The camera of all recordings; positions require its working distance.
    radius_mm
        Radius of the spheres, or the radii of a set of balls, of which each recording shows some or
        all: spheres that were searched for have the radius that fits their size; marked spheres
        have the radii in the order of masks or circles if there is one for each, else those that
        fit.
    led_positions_mm
        As in `calibrate_spheres`.

    Returns
    -------
    SphereCalibration
        `Sphere.recording` is the number of the recording, from 0. Notices about one recording have
        its name as their `rig.Notice.where`.

    Raises
    ------
    DataError, EstimateError
        As `calibrate_spheres`, with the name of the recording; also if there are fewer than two
        recordings, or their sizes or lights differ.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from calibration import calibrate_moved_spheres
    >>> from simulator import render, scene_named
    >>> scene = scene_named("spheres", width=320, height=256, leds=3)
    >>> pairs = [replace(scene, spheres=scene.spheres[i : i + 2]) for i in (0, 2)]
    >>> stacks, truth = zip(*[(r.planes, r.truth) for r in map(render, pairs)])
    >>> masks = [list(one.sphere_masks) for one in truth]
    >>> calibrate_moved_spheres(stacks, masks=masks, camera=truth[0].camera, radius_mm=20).lights
    Lights(3 positions in mm, L00 to L02)
    """
    radii = None if radius_mm is None else _radii(radius_mm)
    labels = list(names)
    seen: list[SeenSpheres] = []
    for k, stack in enumerate(stacks):
        if len(labels) == k:
            labels.append(f"recording {k + 1}")
        lights = _known_lights(stack, seen, labels)
        try:
            found = seen_in(
                stack,
                masks[k] if k < len(masks) else None,
                circles[k] if k < len(circles) else None,
                camera,
                radii,
                all_radii=False,
                lights=lights,
            )
        except (DataError, EstimateError) as error:
            error.args = (f"{labels[k]}: {error}",)
            raise
        if seen and found.size != seen[0].size:
            raise DataError(
                f"{labels[k]} has images of {found.size[1]} x {found.size[0]} pixels, {labels[0]} "
                f"of {seen[0].size[1]} x {seen[0].size[0]}: the recordings must have one size"
            )
        seen.append(found)
    if len(seen) < 2 or len(labels) != len(seen) or max(len(masks), len(circles)) > len(seen):
        raise DataError(
            f"moved spheres need two or more recordings, and at most one name and one list of "
            f"masks or circles for each: {pluralize(len(seen), 'recording')} given"
        )
    return _calibrate(seen, tuple(labels), camera, led_positions_mm)


def _known_lights(
    stack: Stack | Images, seen: list[SeenSpheres], names: list[str]
) -> tuple[str, ...] | None:
    """Return the lights of the first recording; None before it has been read.

    Raises
    ------
    DataError
        If this one, the next, has other lights.
    """
    if not seen:
        return None
    ids = named_stack(stack).ids
    difference = light_difference(names[0], seen[0].names, names[len(seen)], ids)
    if difference:
        raise DataError(difference)
    return seen[0].names


def _calibrate(
    seen: list[SeenSpheres],
    recordings: tuple[str, ...],
    camera: CameraModel | None,
    led_positions_mm: Mapping[str, Sequence[float]] | None,
) -> SphereCalibration:
    """Calibrate from the spheres of all recordings together; errors carry the spheres."""
    images = [image for one in seen for image in one.images]
    try:
        return _lights(seen, images, recordings, camera, led_positions_mm)
    except EstimateError as error:
        error.spheres = circles_of(images)
        raise


def _lights(
    seen: list[SeenSpheres],
    images: list[SphereImage],
    recordings: tuple[str, ...],
    camera: CameraModel | None,
    led_positions_mm: Mapping[str, Sequence[float]] | None,
) -> SphereCalibration:
    missing, notices = lost_lights(seen[0].names, [one.lost for one in seen], images, recordings)
    lit = [k for k in range(len(seen[0].names)) if k not in missing]
    names = tuple(seen[0].names[k] for k in lit)
    places_mm = known_places(led_positions_mm, names)
    if missing:
        images = [replace(one, highlights=one.highlights.take(lit)) for one in images]
    of_recording = [k for k, one in enumerate(seen) for _ in one.images]
    radii = [one.radii_mm for one in seen]
    warnings = notices + [
        replace(notice, where=notice.where or recordings[k])
        for k, one in enumerate(seen)
        for notice in (*one.left_out, *one.doubts)
    ]
    found = [seen[k].found for k in of_recording]
    shown = SeenTogether(names, places_mm, images, of_recording, recordings, found)
    known = [of_one for of_one in radii if of_one is not None]
    cones = [] if camera is None else [cone_of(camera, image) for image in images]
    if camera is None or camera.working_distance_mm is None or not known:
        found_lights = (
            orthographic_lights(shown, warnings)
            if camera is None
            else perspective_lights(shown, cones, camera, warnings)
        )
        if not known:
            return found_lights
        size, sigma = pixel_size(images, np.concatenate(known), camera, cones)
        text = (
            f"a pixel is {size:.4g} mm (sd {sigma / size:.1%}) at the height of the centres of the "
            "spheres, of which the radius is known; positions of lights require a camera with a "
            "working distance"
        )
        notice = Notice("scale-from-spheres", text, severity="info")
        doubts = (*found_lights.warnings, notice)
        return replace(found_lights, warnings=doubts, pixel_mm=size, pixel_sigma_mm=sigma)
    radii_mm = np.concatenate(known)
    placed = place(cones, radii_mm, camera)
    warnings += off_the_plane(placed, camera) + one_off_the_plane(placed, camera, images)
    if len(images) > 1:
        return positioned_lights(shown, cones, radii_mm, camera, warnings)
    left_out = [notice for one in seen for notice in one.left_out]
    if left_out:
        raise EstimateError(
            f"{'; '.join(map(str, left_out))}; positions require two spheres: give masks or "
            "circles, or leave out the radius to get directions"
        )
    text = (
        "one sphere gives only directions, as they are at the sphere: that of a light 500 mm away "
        "is wrong by 1 degree 9 mm away from it; positions require two spheres; nothing shows if "
        "it rests on the board that it mirrors, as is assumed: on a pedestal of a quarter of its "
        "radius, the directions are wrong by 0.5 degrees"
    )
    warnings.append(Notice("one-sphere", text))
    return perspective_lights(shown, cones, camera, warnings, placed)


def _radii(radius_mm: float | Sequence[float]) -> Float64:
    """Return the radii as an array, or raise `DataError` if they are invalid."""
    radii = np.atleast_1d(np.asarray(radius_mm, np.float64))
    if not (len(radii) and np.all(np.isfinite(radii) & (radii > 0))):
        raise DataError("sphere radii must be positive lengths in mm")
    return radii
