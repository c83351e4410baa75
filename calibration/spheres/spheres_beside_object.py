"""Mirror spheres next to the object, in the same images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime

import cv2
import numpy as np

from acquisition import DataError, LightErrors, Lights, Source, exclude
from acquisition.source import setup_differences, source_setup, with_time_errors
from acquisition.values import Calibrated, UsedSphere
from calibration.spheres.geometry.ellipse import Ellipse
from calibration.spheres.solve.sphere_calibration import SphereCalibration
from rig import check_type, listed
from rig.arrays import UInt8

# The bright rim of an outline, blurred by the lens, and the contact shadow extend beyond it.
_MARGIN, _MARGIN_PX = 0.05, 3.0
# A focal length wrong by 0.1 % moves lights by 0.6 mm, as much as the errors of good spheres.
_SAME = 0.001
_LISTED = 4


def apply_spheres(source: Source, spheres: SphereCalibration) -> Source:
    """Return a recording with the lights of mirror spheres that lie next to its object.

    Parameters
    ----------
    source
        The complete recording, not a region of it.
    spheres
        Lights from the images of this recording, in the order of `Source.light_ids`. Images of
        lights that they do not determine are left out.

    Returns
    -------
    Source
        The recording with these lights; its `Source.not_object` covers the spheres and a margin of
        5 % of their radius, at least 3 px, and its `Source.shifts_px` are those by which the
        camera was followed. Intensities, axes and angular falloff are those that the
        source had, with their standard deviations, since spheres do not determine them.

    Raises
    ------
    DataError
        If the source is a region or at a lower resolution, or has other lights.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import apply_spheres, calibrate_spheres
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("coin-with-spheres", width=320, height=256, leds=3))
    >>> full = rendering.planes.max()
    >>> for i, image in enumerate(rendering.planes):
    ...     write_png(f"L0{i}.png", np.rint(65535 * image / full).astype(np.uint16))
    >>> masks = list(rendering.truth.sphere_masks)
    >>> spheres = calibrate_spheres(rendering.planes, masks=masks)
    >>> apply_spheres(read_source("."), spheres).lights
    Lights(3 directions, L00 to L02)
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    check_type("spheres", spheres, SphereCalibration, "calibrate_spheres(stack) returns one")
    lights, before = spheres.lights, source.lights
    if source.reduction is not None:
        raise DataError(
            f"{source.path}: spheres are outlined in complete images: apply them before cropping "
            "or scaling"
        )
    if not set(lights.ids) <= set(source.light_ids):
        raise DataError(f"{source.path}: the lights of the spheres are not those of the images")
    unlit = [name for name in source.light_ids if name not in lights.ids]
    if unlit:
        source = exclude(source, unlit)
        before = source.lights
    if lights.ids != source.light_ids:
        raise DataError(f"{source.path}: the lights of the spheres are in another order")
    if before is None:
        lights = with_time_errors(lights, source.frames)
    else:
        lights = _with_strengths(lights, before)
    covered = np.zeros(source.size, np.uint8)
    for sphere in spheres.spheres:
        _fill(covered, sphere.outline)
    elsewhere = covered > 0
    if source.not_object is not None:
        elsewhere |= source.not_object
    shifts = {name: spheres.shifts_px[name] for name in lights.ids if name in spheres.shifts_px}
    return replace(source, lights=lights, not_object=elsewhere, shifts_px=shifts)


def _with_strengths(lights: Lights, before: Lights) -> Lights:
    """Return the lights with the strengths and patterns of others, and with their errors."""
    errors, known = lights.errors or LightErrors(), before.errors or LightErrors()
    errors = replace(errors, intensity_std=known.intensity_std)
    lights = replace(lights, intensities=before.intensities, errors=errors)
    if not (lights.near and before.near):
        return lights
    errors = replace(errors, axis_std_deg=known.axis_std_deg, mu_std=known.mu_std)
    return replace(lights, axes=before.axes, mu=before.mu, errors=errors)


def _fill(covered: UInt8, outline: Ellipse) -> None:
    """Mark the pixels of a sphere and its margin."""
    margin = max(_MARGIN * outline.radius_px, _MARGIN_PX)
    angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    edge = outline.point(angles, 1 + margin / outline.radius_px)
    cv2.fillPoly(covered, [np.rint(edge).astype(np.int32)], 1)


def record_setup(estimate: SphereCalibration, source: Source, *others: Source) -> SphereCalibration:
    """Return a calibration whose lights state time, rig, camera, lens and spheres.

    The time is the start of the (first) recording, or now if the recording does not state it. Only
    sessions of a rig know their rig. `write_lights` writes all of it to lights.json, and
    `acquisition.source.setup_notices` compares it with a recording.

    Parameters
    ----------
    estimate
        Result of `calibrate_spheres` or `calibrate_moved_spheres`.
    source
        The recording that shows the spheres.
    others
        Further recordings with the balls elsewhere, in the order in which they were calibrated.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import read_source, write_png
    >>> from calibration import calibrate_spheres
    >>> from calibration.spheres import record_setup
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("spheres", width=160, height=128, leds=3))
    >>> write_png("L00.png", np.rint(9e3 * rendering.planes[0]).astype(np.uint16))
    >>> masks = list(rendering.truth.sphere_masks)
    >>> estimate = calibrate_spheres(rendering.planes, masks=masks)
    >>> len(record_setup(estimate, read_source("L00.png")).lights.calibrated.spheres)
    4
    """
    check_type("estimate", estimate, SphereCalibration, "calibrate_spheres(stack) returns one")
    sources = (source, *others)
    spheres = tuple(
        UsedSphere(
            sphere.outline.centre_px,
            math.sqrt(math.prod(sphere.outline.semi_axes_px)),
            sphere.centre_mm,
            sphere.radius_mm,
            str(sources[sphere.recording].path) if others else "",
        )
        for sphere in estimate.spheres
    )
    time = source.recorded_utc or datetime.now(UTC).replace(microsecond=0)
    calibrated = Calibrated(time, source_setup(source), spheres)
    return replace(estimate, lights=replace(estimate.lights, calibrated=calibrated))


def check_recordings(sources: Sequence[Source]) -> None:
    """Refuse recordings of moved spheres under different rigs, cameras, lenses or lights.

    What one of them does not state is not compared. Lenses are the same if their rays agree to
    0.1 % of half the field of view.

    Parameters
    ----------
    sources
        Recordings of the same lights; each is compared with the first.

    Raises
    ------
    DataError
        One line that names both recordings and what differs.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import CameraModel, read_source, write_png
    >>> from calibration.spheres import check_recordings
    >>> write_png("L00.png", np.full((40, 50), 700, np.uint16))
    >>> cameras = [CameraModel([[f, 0, 25], [0, f, 20], [0, 0, 1]], 50, 40) for f in (90, 95)]
    >>> try:
    ...     check_recordings([read_source("L00.png", camera=camera) for camera in cameras])
    ... except ValueError as error:
    ...     print(str(error)[:59])
    L00.png differs from L00.png: focal length 90 px at 50 x 40
    """
    for source in sources:
        check_type("source", source, Source, "acquisition.read_source(path) returns one")
    first = sources[0]
    setup = source_setup(first)
    for other in sources[1:]:
        if other.size != first.size:
            (h, w), (height, width) = first.size, other.size
            raise DataError(
                f"{other.path} has images of {width} x {height} pixels, {first.path} of {w} x {h}: "
                "the recordings must be of one camera, with images of one size"
            )
        differences = setup_differences(setup, source_setup(other), _SAME)
        if differences:
            raise DataError(
                f"{other.path} differs from {first.path}: {', '.join(differences)}; recordings "
                "with moved spheres need one rig and one camera"
            )
        different = light_difference(
            str(first.path), first.light_ids, str(other.path), other.light_ids
        )
        if different:
            raise DataError(different)


def light_difference(
    first: str, first_ids: Sequence[str], other: str, other_ids: Sequence[str]
) -> str:
    """Return one line if two recordings do not show the same lights, in any order; else ""."""
    given = ((first, first_ids), (other, other_ids))
    for (without, known), (shows, names) in (given, given[::-1]):
        rest = [name for name in names if name not in known]
        if rest:
            return (
                f"{without} has no light {listed(rest, _LISTED)}, which {shows} shows: the same "
                "light must have the same name in all recordings"
            )
    return ""
