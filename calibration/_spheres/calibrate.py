"""Calibration of light directions or positions from mirror spheres."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, LightErrors, Lights, angle_deg, led_id
from calibration._errors import EstimateError
from calibration._radiance.linear_stack import Stack, check_linear
from calibration._spheres.cone import Cone
from calibration._spheres.direction_errors import direction_covariances
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.input_tests import check_inputs, doubts
from calibration._spheres.known_places import known_places
from calibration._spheres.light_positions import locate_lights, observed_rays
from calibration._spheres.marked import Mask, circled_spheres, masked_spheres
from calibration._spheres.outline_noise import circle_covariance, viewing_cone
from calibration._spheres.placed import off_the_plane, one_radius_each, place, systematic
from calibration._spheres.reflection import orthographic_directions, reflected_rays
from calibration._spheres.robust import Array
from calibration._spheres.search import searched_spheres
from calibration._spheres.sphere_calibration import (
    Sphere,
    SphereCalibration,
    placed_spheres,
    seen_spheres,
)
from calibration._spheres.sphere_image import (
    SphereImage,
    missing_highlights_warning,
    partial_outline_warning,
    places,
    saturation_warning,
)
from rig import Notice, pluralize

_DISAGREEMENT_DEG = 3.0
_POOR_RESIDUAL_DEG = 0.2
# The refinement moves wrong spheres until they nearly agree, so a remaining error of half a degree
# means an error of many degrees of the lights.
_UNTRUSTED_DEG = 0.5
_LEAST_AGREEING = 0.5
# A standard deviation above which an error of 2 mm is likely.
_UNCERTAIN_MM = 1.6


def calibrate_spheres(
    stack: Stack | npt.NDArray[np.float32],
    *,
    masks: Sequence[Mask] | None = None,
    circles: Sequence[tuple[float, float, float]] | None = None,
    camera: CameraModel | None = None,
    radius_mm: float | Sequence[float] | None = None,
    led_positions_mm: Mapping[str, Sequence[float]] | None = None,
) -> SphereCalibration:
    """Estimate lights from their highlights on mirror spheres.

    Without a camera, an orthographic view is assumed; for a near light and one sphere the error is
    a few degrees. With a camera, the viewing cone of each sphere is used, which requires no radius
    for directions. With a camera, a radius and two or more spheres, the lights have positions.

    Parameters
    ----------
    stack
        One linear image per light, as returned by `linear_stack`, or ``(N, H, W[, 3])`` values of
        lights ``L00``..., 1 at the white level of the longest exposure, NaN where saturated.
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

    Returns
    -------
    SphereCalibration
        Lights and quality of the fit.

    Raises
    ------
    DataError
        If shapes or radii are inconsistent, the camera does not fit the images, both masks and
        circles are given, or a radius is given without a camera.
    EstimateError
        If no sphere is found, a light has no highlight, or a light is visible on fewer than two
        spheres although positions are requested. The message names the light or the spheres.

    Examples
    --------
    >>> from calibration import calibrate_spheres
    >>> from simulator import render, scene_named
    >>> rendering = render(scene_named("spheres", width=160, height=128, leds=3))
    >>> masks = list(rendering.truth.sphere_masks)
    >>> calibrate_spheres(rendering.planes, masks=masks).lights
    Lights(3 directions, L00 to L02)
    """
    check_linear("stack", stack)
    values, names = _values(stack)
    if camera is not None and camera.size != values.shape[1:]:
        raise DataError(
            f"the camera is {camera.width} x {camera.height} pixels, the images are "
            f"{values.shape[2]} x {values.shape[1]}: use the camera of these images"
        )
    radii = None if radius_mm is None else _radii(radius_mm, camera)
    known = known_places(led_positions_mm, names)
    # Arrays of several masks or circles have no truth value.
    masks = [] if masks is None else list(masks)
    circles = [] if circles is None else list(circles)
    if masks and circles:
        raise DataError("both masks and circles mark the spheres: give one of the two")
    found = not masks and not circles
    left_out: list[Notice] = []
    if masks:
        images = masked_spheres(values, masks)
    elif circles:
        images = circled_spheres(values, circles)
    else:
        images, left_out = searched_spheres(values, camera, radii)
    highlights = np.stack([image.highlights.pixels for image in images], axis=1)
    _check_seen(highlights, names, images)
    warnings = [*left_out, *missing_highlights_warning(images), *saturation_warning(images)]
    warnings += partial_outline_warning(images)
    if camera is None:
        outlines = [image.outline for image in images]

        def orthographic(pixels: Array, change: Array) -> Array:
            pairs = zip(outlines, np.moveaxis(pixels, 1, 0), change, strict=True)
            rays = [orthographic_directions(_changed(o, by), of_one) for o, of_one, by in pairs]
            return np.stack(rays, axis=1)

        covariances = [circle_covariance(image.points_px, image.outline) for image in images]
        return _directions(names, seen_spheres(images), images, orthographic, covariances, warnings)
    cones = [viewing_cone(camera.rays(image.points_px), 1 / camera.focal_px) for image in images]

    def perspective(pixels: Array, change: Array) -> Array:
        centres = np.array([cone.axis / cone.sine for cone in cones]) + change
        return reflected_rays(camera.rays(pixels), centres, 1.0)[1]

    if radii is None:
        spheres = seen_spheres(images)
        covariances = [cone.covariance + systematic(cone, camera) for cone in cones]
        return _directions(names, spheres, images, perspective, covariances, warnings)
    radii = one_radius_each(radii, images, camera, found=found)
    placed = place(cones, radii, camera)
    warnings += off_the_plane(placed, camera)
    if len(images) > 1:
        return _positions(names, images, cones, radii, camera, known, warnings, found=found)
    if left_out:
        raise EstimateError(
            f"{'; '.join(map(str, left_out))}; positions require two spheres: give masks or "
            "circles, or leave out the radius to get directions"
        )
    text = "one sphere gives only directions: positions require two spheres"
    warnings.append(Notice("one-sphere", text))
    spheres = placed_spheres(images, placed.centres_mm, radii)
    covariances = [placed.covariance_mm2 / radii[0] ** 2]
    return _directions(names, spheres, images, perspective, covariances, warnings)


def _changed(outline: Ellipse, change: Array) -> Ellipse:
    """Return an outline with changed centre x, centre y and radius, in pixels."""
    (x, y), (a, b) = outline.centre_px, outline.semi_axes_px
    scale = 1 + float(change[2]) / outline.radius_px
    return replace(
        outline,
        centre_px=(x + float(change[0]), y + float(change[1])),
        semi_axes_px=(a * scale, b * scale),
    )


def _values(
    stack: Stack | npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float32], tuple[str, ...]]:
    """Return grey values ``(N, H, W)`` and the names of the N lights."""
    values = stack.values if isinstance(stack, Stack) else np.asarray(stack, np.float32)
    if values.ndim == 4:
        values = values.mean(axis=3)  # a NaN channel makes the sample NaN
    if values.ndim != 3 or 0 in values.shape:
        raise DataError(
            f"a stack of sphere images must have the shape (N, H, W[, 3]), not {values.shape}"
        )
    names = stack.ids if isinstance(stack, Stack) else tuple(map(led_id, range(len(values))))
    if len(names) != len(values):
        raise DataError(
            f"{pluralize(len(names), 'light')} for {pluralize(len(values), 'image')}: give one for "
            "each image"
        )
    return values, names


def _radii(radius_mm: float | Sequence[float], camera: CameraModel | None) -> Array:
    """Return the radii as an array, or raise `DataError` if they are invalid."""
    radii = np.atleast_1d(np.asarray(radius_mm, np.float64))
    if not (len(radii) and np.all(np.isfinite(radii) & (radii > 0))):
        raise DataError("sphere radii must be positive lengths in mm")
    if camera is None or camera.working_distance_mm is None:
        raise DataError(
            "a sphere radius requires a camera with a working distance: add it, or leave out the "
            "radius to get directions"
        )
    return radii


def _check_seen(highlights: Array, names: tuple[str, ...], images: list[SphereImage]) -> None:
    """Raise `EstimateError` if a light has no highlight on any sphere, in ``(N, K, 2)``."""
    seen = np.isfinite(highlights[..., 0])
    missing = [name for name, on in zip(names, seen, strict=True) if not on.any()]
    if missing:
        raise EstimateError(
            f"no highlight under light {', '.join(missing[:4])} ({len(missing)} of {len(names)} "
            f"lights) on {places(images)}: check that the light was on and that the outline is "
            "correct"
        )


def _directions(
    names: tuple[str, ...],
    spheres: tuple[Sphere, ...],
    images: list[SphereImage],
    rays_of: Callable[[Array, Array], Array],
    outline_covariances: list[Array],
    warnings: list[Notice],
) -> SphereCalibration:
    """Average the directions that `rays_of` returns for highlights and changes of the outlines."""
    highlights = np.stack([image.highlights.pixels for image in images], axis=1)
    sigma_px = np.stack([image.highlights.sigma_px for image in images], axis=1)
    rays = rays_of(highlights, np.zeros((len(images), 3)))
    seen = np.isfinite(rays[..., 0])
    if not seen.any(axis=1).all():
        name = names[int(np.argmin(seen.any(axis=1)))]
        raise EstimateError(
            f"the highlight under light {name} is outside the sphere: check the outline"
        )
    directions = np.nansum(rays, axis=1)
    residuals = _rms(angle_deg(directions[:, None], rays), seen)
    residuals[seen.sum(axis=1) < 2] = np.nan
    if np.any(residuals > _DISAGREEMENT_DEG):
        worst = float(np.nanmax(residuals))
        text = (
            f"the light directions of the spheres differ by up to {worst:.1f} degrees: the lights "
            "are near; give a camera and a radius to get positions"
        )
        warnings.append(Notice("lights-near", text))
    errors = LightErrors(
        direction_covariances(rays_of, highlights, sigma_px, np.array(outline_covariances)),
        spheres=seen.sum(axis=1),
    )
    lights = Lights(directions=directions, ids=names, errors=errors)
    return SphereCalibration(lights, spheres, highlights, seen, residuals, tuple(warnings))


def _positions(
    names: tuple[str, ...],
    images: list[SphereImage],
    cones: list[Cone],
    radii: Array,
    camera: CameraModel,
    known: Array,
    warnings: list[Notice],
    *,
    found: bool,
) -> SphereCalibration:
    """Estimate positions; leave out a sphere that was searched for and contradicts the others."""
    placed = place(cones, radii, camera)
    highlights = np.stack([image.highlights.pixels for image in images], axis=1)
    sigma_px = np.stack([image.highlights.sigma_px for image in images], axis=1)
    located = locate_lights(camera, placed, highlights, sigma_px, names)
    positions, centres = located.refined.positions_mm, located.refined.centres_mm
    used = located.used
    seen = np.isfinite(highlights[..., 0])
    share = used.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    worst = int(np.argmin(share))
    # With only two spheres it is unknown which one is wrong; the residuals show the contradiction.
    if found and len(images) > 2 and share[worst] < _LEAST_AGREEING:
        text = (
            f"{places([images[worst]])} was left out: only {used[:, worst].sum()} of its "
            f"{seen[:, worst].sum()} highlights agree with the other spheres"
        )
        warnings.append(Notice("sphere-contradicts", text))
        kept = [k for k in range(len(images)) if k != worst]
        images, cones = [images[k] for k in kept], [cones[k] for k in kept]
        return _positions(names, images, cones, radii[kept], camera, known, warnings, found=found)
    points, rays = observed_rays(camera, replace(placed, centres_mm=centres), highlights)
    residuals = _rms(angle_deg(positions[:, None] - points, rays), used)
    disagreement = float(np.median(residuals))
    if disagreement > _UNTRUSTED_DEG:
        text = (
            f"the spheres contradict each other by {disagreement:.1f} degrees: do not trust these "
            "lights; check outlines, radii and camera"
        )
        warnings.append(Notice("lights-untrusted", text))
    elif disagreement > _POOR_RESIDUAL_DEG:
        text = (
            f"the spheres agree about the lights only to {disagreement:.1f} degrees: "
            "check outlines, radii and camera"
        )
        warnings.append(Notice("spheres-disagree", text))
    if disagreement <= _UNTRUSTED_DEG:
        outlines = [image.points_px for image in images]
        weighed = np.where(used, sigma_px, np.inf)
        tests = check_inputs(camera, placed, outlines, located.refined, highlights, weighed)
        warnings = _with_doubts(warnings, doubts(tests, camera, radii, known))
    dropped = int(np.sum(seen & ~used))
    if dropped:
        text = f"{dropped} highlights disagree with the other spheres and were left out"
        warnings.append(Notice("highlights-left-out", text))
    sigma_mm = float(np.sqrt(np.trace(located.refined.covariance_mm2, axis1=1, axis2=2).mean()))
    if sigma_mm > _UNCERTAIN_MM:
        text = (
            f"the positions of the lights are uncertain by {sigma_mm:.1f} mm (standard deviation): "
            "use larger spheres, more of them, farther apart, or a camera with more pixels"
        )
        warnings.append(Notice("lights-uncertain", text))
    errors = LightErrors(
        located.refined.covariance_mm2,
        residual_px=located.residuals_px,
        spheres=used.sum(axis=1),
    )
    lights = Lights(positions_mm=positions, ids=names, errors=errors)
    spheres = placed_spheres(images, centres, radii)
    return SphereCalibration(lights, spheres, highlights, used, residuals, tuple(warnings))


def _with_doubts(warnings: list[Notice], doubts: list[Notice]) -> list[Notice]:
    """Add doubts about the given values; a warning that spheres are off the plane takes them up."""
    off = [k for k, warning in enumerate(warnings) if warning.code == "spheres-off-the-plane"]
    if not (off and doubts):
        return warnings + doubts
    text = "; ".join(notice.text for notice in (warnings[off[0]], *doubts))
    return [replace(one, text=text) if k == off[0] else one for k, one in enumerate(warnings)]


def _rms(angle_deg: Array, use: npt.NDArray[np.bool_]) -> Array:
    """Return the root mean square ``(N,)`` of the used angles among ``(N, K)``."""
    square = np.where(use, angle_deg, 0.0) ** 2
    rms: Array = np.sqrt(square.sum(axis=1) / np.maximum(use.sum(axis=1), 1))
    return rms
