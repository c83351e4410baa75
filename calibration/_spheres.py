"""Lights from mirror spheres: outlines, highlights, then directions or positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, DataError, Lights, led_id
from calibration._conic import Array, Cone, Ellipse, fit_cone
from calibration._errors import EstimateError
from calibration._find_spheres import SphereImage
from calibration._light_positions import locate_lights, observed_rays
from calibration._placed_spheres import off_the_plane, place, radii_of
from calibration._radiance import Stack
from calibration._reflection import orthographic_directions, reflected_rays
from calibration._search import searched_spheres
from calibration._sphere_images import (
    Mask,
    circled_spheres,
    masked_spheres,
    places,
    saturation_warning,
)

_DISAGREEMENT_DEG = 3.0
_POOR_RESIDUAL_DEG = 0.2
# Refining moves wrong spheres until they nearly agree: half a degree left is many at the lights.
_UNTRUSTED_DEG = 0.5
_LEAST_AGREEING = 0.5


@dataclass(frozen=True)
class Sphere:
    """A mirror sphere as it was found.

    Parameters
    ----------
    outline
        Ellipse of its outline in the image.
    coverage
        Share 0..1 of the circumference that was seen.
    rms_px
        Scatter of the outline points about the outline.
    centre_mm, radius_mm
        In the house frame, where camera and radius are known.
    """

    outline: Ellipse
    coverage: float
    rms_px: float
    centre_mm: tuple[float, float, float] | None = None
    radius_mm: float | None = None


@dataclass(frozen=True, eq=False)
class SphereCalibration:
    """Lights, and the evidence for them.

    Parameters
    ----------
    lights
        Positions where camera and radius are known and there are two or more spheres, directions
        otherwise. Intensities are 1: a highlight tells where a light is, not how strong.
    spheres
        K spheres.
    highlights_px
        ``(N, K, 2)`` highlight of light n on sphere k; NaN where none was found.
    used
        ``(N, K)`` highlights that agree with the light.
    residuals_deg
        ``(N,)`` rms angle between the light and the directions from which its used highlights
        show it. NaN for a direction that only one sphere shows.
    warnings
        What deserves a look, one line each.
    """

    lights: Lights
    spheres: tuple[Sphere, ...]
    highlights_px: Array
    used: npt.NDArray[np.bool_]
    residuals_deg: Array
    warnings: tuple[str, ...]


def calibrate_spheres(
    stack: Stack | npt.NDArray[np.float32],
    *,
    masks: Sequence[Mask] | None = None,
    circles: Sequence[tuple[float, float, float]] | None = None,
    camera: CameraModel | None = None,
    radius_mm: float | Sequence[float] | None = None,
    ids: Sequence[str] = (),
) -> SphereCalibration:
    """Estimate lights from the highlights they make on mirror spheres.

    Without a camera the view is taken as orthographic: for one sphere of a near light that is a few
    degrees off. With a camera the viewing cone of each sphere is used, which needs no radius for
    directions. With camera, radius and two or more spheres the lights get positions.

    Parameters
    ----------
    stack
        One linear image per light: what `linear_stack` returns, or ``(N, H, W[, 3])`` values, 1 at
        the white level of the longest exposure, NaN where saturated. Brackets merged into the
        stack carry unsaturated highlights as values far above 1.
    masks
        ``(H, W)`` bool or 0..1, one or more; each connected region is a sphere.
    circles
        Rough circles (x, y, radius) in pixels, refined on the images. Without masks and circles
        the spheres are found; with camera and radius only those of the right size, if they lay
        about the working plane. What was found is left out, with a warning, where it is of another
        size, its outline is far less sharp than that of the others, or most of its highlights
        disagree with them.
    camera
        Camera model; positions need its working distance.
    radius_mm
        Radius of the spheres, or one for each: in the order of masks or circles; for spheres that
        were found, larger radii go to larger outlines.
    ids
        Names of the lights. Default: those of the stack, else ``L00``...

    Returns
    -------
    SphereCalibration
        Lights and evidence.

    Raises
    ------
    DataError
        If shapes or radii disagree with each other, or the camera with the images.
    EstimateError
        If no sphere is found, a light has no highlight, fewer than two spheres show it where
        positions are wanted. The message names the light or the spheres.
    """
    values, names = _values(stack, ids)
    if camera is not None and camera.size != values.shape[1:]:
        raise DataError(
            f"the camera is {camera.width} x {camera.height} pixels, the images are "
            f"{values.shape[2]} x {values.shape[1]}: use the camera of these images"
        )
    found = masks is None and circles is None
    left_out: list[str] = []
    if masks is not None:
        images = masked_spheres(values, masks)
    elif circles is not None:
        images = circled_spheres(values, circles)
    else:
        images, left_out = searched_spheres(values, camera, radius_mm)
    highlights = np.stack([image.highlights.pixels for image in images], axis=1)
    missing = [
        name
        for name, seen in zip(names, np.isfinite(highlights[..., 0]), strict=True)
        if not seen.any()
    ]
    if missing:
        raise EstimateError(
            f"no highlight under light {', '.join(missing[:4])} ({len(missing)} of {len(names)} "
            f"lights) on {places(images)}: check that the light was on and the outline is right"
        )
    warnings = [*left_out, *saturation_warning(images)]
    if camera is None:
        if radius_mm is not None:
            raise DataError("a sphere radius needs a camera: add one, or leave the radius out")
        spheres = [_sphere(image) for image in images]
        rays = np.stack(
            [orthographic_directions(image.outline, image.highlights.pixels) for image in images],
            axis=1,
        )
        return _distant(names, spheres, highlights, rays, warnings)
    pixel_angle = 1 / float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
    cones = [fit_cone(camera.rays(image.points_px), pixel_angle)[0] for image in images]
    if radius_mm is None:
        rays = np.stack(
            [
                reflected_rays(camera.rays(image.highlights.pixels), cone.axis, cone.sine)[1]
                for image, cone in zip(images, cones, strict=True)
            ],
            axis=1,
        )
        spheres = [_sphere(image) for image in images]
        return _distant(names, spheres, highlights, rays, warnings)
    radii = radii_of(radius_mm, images, found=found)
    warnings += off_the_plane(place(cones, radii, camera), camera)
    if len(images) == 1:
        if left_out:
            raise EstimateError(
                f"{'; '.join(left_out)}; positions need two spheres: give masks or circles, or "
                "leave the radius out to get directions"
            )
        warnings.append("one sphere gives directions only: positions need two")
        known = place(cones, radii, camera)
        _, rays = observed_rays(camera, known, highlights)
        spheres = [_sphere(images[0], known.centres_mm[0], radii[0])]
        return _distant(names, spheres, highlights, rays, warnings)
    return _located(names, images, cones, radii, camera, warnings, found=found)


def _located(
    names: tuple[str, ...],
    images: list[SphereImage],
    cones: list[Cone],
    radii: Array,
    camera: CameraModel,
    warnings: list[str],
    *,
    found: bool,
) -> SphereCalibration:
    """Find positions; leave out what was found as a sphere and contradicts the others."""
    known = place(cones, radii, camera)
    highlights = np.stack([image.highlights.pixels for image in images], axis=1)
    saturated = np.stack([image.highlights.saturated for image in images], axis=1)
    positions, centres, used = locate_lights(camera, known, highlights, saturated, names)
    seen = np.isfinite(highlights[..., 0])
    share = used.sum(axis=0) / seen.sum(axis=0)
    worst = int(np.argmin(share))
    # Of two spheres none is the odd one: their residuals tell.
    if found and len(images) > 2 and share[worst] < _LEAST_AGREEING:
        warnings.append(
            f"{places([images[worst]])} was left out: {used[:, worst].sum()} of its "
            f"{seen[:, worst].sum()} highlights agree with the other spheres"
        )
        kept = [k for k in range(len(images)) if k != worst]
        images, cones = [images[k] for k in kept], [cones[k] for k in kept]
        return _located(names, images, cones, radii[kept], camera, warnings, found=found)
    spheres = [
        _sphere(image, centre, radius)
        for image, centre, radius in zip(images, centres, radii, strict=True)
    ]
    points, rays = observed_rays(camera, replace(known, centres_mm=centres), highlights)
    toward = positions[:, None] - points
    residuals = _rms(_angle_deg(toward, rays), used)
    disagreement = float(np.median(residuals))
    if disagreement > _UNTRUSTED_DEG:
        warnings.append(
            f"the spheres contradict each other by {disagreement:.1f} degrees: these lights are "
            "not to be trusted; check outlines, radii and camera"
        )
    elif disagreement > _POOR_RESIDUAL_DEG:
        warnings.append(
            f"the spheres agree about the lights to {disagreement:.1f} degrees only: "
            "check outlines, radii and camera"
        )
    dropped = int(np.sum(seen & ~used))
    if dropped:
        warnings.append(f"{dropped} highlights disagree with the other spheres and were left out")
    return SphereCalibration(
        Lights(positions_mm=positions, ids=names),
        tuple(spheres),
        highlights,
        used,
        residuals,
        tuple(warnings),
    )


def _values(
    stack: Stack | npt.NDArray[np.float32], ids: Sequence[str]
) -> tuple[npt.NDArray[np.float32], tuple[str, ...]]:
    values = stack.values if isinstance(stack, Stack) else np.asarray(stack, np.float32)
    if values.ndim == 4:
        values = values.mean(axis=3)  # a NaN channel makes the sample NaN
    if values.ndim != 3 or 0 in values.shape:
        raise DataError(f"a stack for spheres must be (N, H, W[, 3]), not {values.shape}")
    names = tuple(ids) or (stack.ids if isinstance(stack, Stack) else ())
    names = names or tuple(map(led_id, range(len(values))))
    if len(names) != len(values):
        raise DataError(f"{len(names)} names for {len(values)} images: every image needs one light")
    return values, names


def _sphere(
    image: SphereImage, centre_mm: Array | None = None, radius_mm: float | None = None
) -> Sphere:
    centre = (
        None
        if centre_mm is None
        else (float(centre_mm[0]), float(centre_mm[1]), float(centre_mm[2]))
    )
    return Sphere(
        image.outline,
        image.coverage,
        image.rms_px,
        centre,
        None if radius_mm is None else float(radius_mm),
    )


def _distant(
    names: tuple[str, ...],
    spheres: list[Sphere],
    highlights: Array,
    rays: Array,
    warnings: list[str],
) -> SphereCalibration:
    """Average the directions ``(N, K, 3)`` that the spheres show."""
    seen = np.isfinite(rays[..., 0])
    if not seen.any(axis=1).all():
        name = names[int(np.argmin(seen.any(axis=1)))]
        raise EstimateError(
            f"the highlight under light {name} lies outside of the sphere: check the outline"
        )
    directions = np.nansum(rays, axis=1)
    residuals = _rms(_angle_deg(directions[:, None], rays), seen)
    residuals[seen.sum(axis=1) < 2] = np.nan
    if np.any(residuals > _DISAGREEMENT_DEG):
        worst = float(np.nanmax(residuals))
        warnings.append(
            f"the spheres see lights in directions up to {worst:.1f} degrees apart: the lights are "
            "near; give camera and radius to get positions"
        )
    return SphereCalibration(
        Lights(directions=directions, ids=names),
        tuple(spheres),
        highlights,
        seen,
        residuals,
        tuple(warnings),
    )


def _angle_deg(a: Array, b: Array) -> Array:
    cross = np.linalg.norm(np.cross(a, b), axis=-1)
    angle: Array = np.degrees(np.arctan2(cross, np.sum(a * b, axis=-1)))
    return angle


def _rms(angle_deg: Array, use: npt.NDArray[np.bool_]) -> Array:
    square = np.where(use, angle_deg, 0.0) ** 2
    rms: Array = np.sqrt(square.sum(axis=1) / np.maximum(use.sum(axis=1), 1))
    return rms
