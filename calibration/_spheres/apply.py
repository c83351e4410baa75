"""Mirror spheres next to the object, in the same images."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from acquisition import DataError, LightErrors, Lights, Source, exclude, with_time_errors
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.sphere_calibration import SphereCalibration
from rig import check_type

# The bright rim of an outline, blurred by the lens, and the contact shadow extend beyond it.
_MARGIN, _MARGIN_PX = 0.05, 3.0


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
        5 % of their radius, at least 3 px. Intensities, axes and angular falloff are those that the
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
    return replace(source, lights=lights, not_object=elsewhere)


def _with_strengths(lights: Lights, before: Lights) -> Lights:
    """Return the lights with the strengths and patterns of others, and with their errors."""
    errors, known = lights.errors or LightErrors(), before.errors or LightErrors()
    errors = replace(errors, intensity_std=known.intensity_std)
    lights = replace(lights, intensities=before.intensities, errors=errors)
    if not (lights.near and before.near):
        return lights
    errors = replace(errors, axis_std_deg=known.axis_std_deg, mu_std=known.mu_std)
    return replace(lights, axes=before.axes, mu=before.mu, errors=errors)


def _fill(covered: npt.NDArray[np.uint8], outline: Ellipse) -> None:
    """Mark the pixels of a sphere and its margin."""
    margin = max(_MARGIN * outline.radius_px, _MARGIN_PX)
    angles = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    edge = outline.point(angles, 1 + margin / outline.radius_px)
    cv2.fillPoly(covered, [np.rint(edge).astype(np.int32)], 1)
