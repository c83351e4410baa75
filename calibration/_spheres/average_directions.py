"""Light directions as the mean of those that the spheres show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from acquisition import CameraModel, LightErrors, Lights, angle_deg
from calibration._errors import EstimateError
from calibration._spheres.cone import Cone
from calibration._spheres.direction_errors import direction_covariances
from calibration._spheres.joint_refinement import KnownSpheres
from calibration._spheres.outline_noise import outline_covariance
from calibration._spheres.placed import COMMON_SHARE, common_error, systematic
from calibration._spheres.reflection import orthographic_directions, reflected_rays
from calibration._spheres.robust import Array
from calibration._spheres.seen_together import SeenTogether, rms_deg
from calibration._spheres.sphere_calibration import (
    Sphere,
    SphereCalibration,
    placed_spheres,
    seen_spheres,
)
from calibration._spheres.sphere_image import SphereImage, places
from rig import Notice

_DISAGREEMENT_DEG = 3.0
# Directions with larger standard deviations are no calibration.
_LARGEST_SIGMA_DEG = 10.0


def orthographic_lights(shown: SeenTogether, warnings: list[Notice]) -> SphereCalibration:
    """Return directions without a camera: every viewing ray is parallel to the axis."""
    outlines = [image.outline for image in shown.images]

    def rays_of(pixels: Array, change: Array) -> Array:
        pairs = zip(outlines, np.moveaxis(pixels, 1, 0), change, strict=True)
        rays = [orthographic_directions(o.moved(by), of_one) for o, of_one, by in pairs]
        return np.stack(rays, axis=1)

    # Centre x, centre y and radius of each outline.
    common = np.zeros((len(outlines), 3))
    common[:, 2] = [COMMON_SHARE**0.5 * image.systematic_px for image in shown.images]
    pairs = zip(shown.images, common, strict=True)
    own = [outline_covariance(image) - np.outer(shared, shared) for image, shared in pairs]
    return _directions(shown, seen_spheres(shown.images), rays_of, own, common, warnings)


def perspective_lights(
    shown: SeenTogether,
    cones: Sequence[Cone],
    camera: CameraModel,
    warnings: list[Notice],
    placed: KnownSpheres | None = None,
) -> SphereCalibration:
    """Return directions seen from the centre of a sphere; ``placed`` is one of known radius."""
    centres = np.array([cone.axis / cone.sine for cone in cones])

    def rays_of(pixels: Array, change: Array) -> Array:
        return reflected_rays(camera.rays(pixels), centres + change, 1.0)[1]

    if placed is None:
        spheres = seen_spheres(shown.images)
        own = [cone.covariance + systematic(cone, camera) for cone in cones]
        common = np.array([common_error(cone, camera) for cone in cones])
    else:
        spheres = placed_spheres(shown.images, placed.centres_mm, placed.radii_mm)
        own = [placed.covariance_mm2 / placed.radii_mm[0] ** 2]
        common = np.zeros((1, 3))
    return _directions(shown, spheres, rays_of, own, common, warnings)


def _directions(
    shown: SeenTogether,
    spheres: tuple[Sphere, ...],
    rays_of: Callable[[Array, Array], Array],
    outline_covariances: list[Array],
    outlines_common: Array,
    warnings: list[Notice],
) -> SphereCalibration:
    """Average the directions that `rays_of` returns for highlights and changes of the outlines."""
    names, images = shown.lights, shown.images
    highlights = np.stack([image.highlights.pixels for image in images], axis=1)
    sigma_px = np.stack([image.highlights.sigma_px for image in images], axis=1)
    _check_decided(names, images)
    rays = rays_of(highlights, np.zeros((len(images), 3)))
    seen = np.isfinite(rays[..., 0])
    if not seen.any(axis=1).all():
        name = names[int(np.argmin(seen.any(axis=1)))]
        raise EstimateError(
            f"the highlight under light {name} is outside the sphere: check the outline"
        )
    directions = np.nansum(rays, axis=1)
    residuals = rms_deg(angle_deg(directions[:, None], rays), seen)
    residuals[seen.sum(axis=1) < 2] = np.nan
    if np.any(residuals > _DISAGREEMENT_DEG):
        worst = float(np.nanmax(residuals))
        text = (
            f"the light directions of the spheres differ by up to {worst:.1f} degrees: the lights "
            "are near; give a camera and a radius to get positions"
        )
        warnings.append(Notice("lights-near", text))
    warnings += _unlike(names, images)
    _check_alike(images)
    covariances = direction_covariances(
        rays_of, highlights, sigma_px, np.array(outline_covariances), outlines_common
    )
    _check_known(names, covariances, images)
    errors = LightErrors(covariances, spheres=seen.sum(axis=1))
    lights = Lights(directions=directions, ids=names, errors=errors)
    spheres = shown.numbered(spheres)
    return SphereCalibration(lights, spheres, highlights, seen, residuals, tuple(warnings))


def _unlike(names: tuple[str, ...], images: Sequence[SphereImage]) -> list[Notice]:
    """Return a notice for each sphere on which some lights have no highlight of the usual size."""
    notices = []
    for image in images:
        odd = [names[k] for k in image.highlights.unlike]
        if odd:
            more = f" (and {len(odd) - 4} more lights)" if len(odd) > 4 else ""
            text = (
                f"under light {', '.join(odd[:4])}{more}, no bright spot on {places([image])} has "
                "the size of the highlights under the other lights: a reflection may be a part of "
                "it, or hide it; look at these images, cover what shines, or add a short exposure"
            )
            notices.append(Notice("highlights-unlike", text))
    return notices


def _check_alike(images: Sequence[SphereImage]) -> None:
    """Raise `EstimateError` if most highlights on each sphere differ in size."""
    shown = [image.highlights for image in images]
    if all(2 * len(one.unlike) > np.count_nonzero(one.found) for one in shown):
        raise EstimateError(
            f"{places(list(images))}: the bright spots under most lights differ in size, and are "
            "not round: they may be reflections; cover what shines, or add a short exposure"
        )


def _check_known(names: tuple[str, ...], covariances: Array, images: Sequence[SphereImage]) -> None:
    """Raise `EstimateError` if directions, or a single one, are known to 10 degrees or worse."""
    sigma_deg = np.degrees(np.sqrt(np.trace(covariances, axis1=1, axis2=2) / 2))
    if not np.isfinite(sigma_deg).any():
        return
    middle = float(np.nanmedian(sigma_deg))
    if middle > _LARGEST_SIGMA_DEG:
        raise EstimateError(
            f"{places(list(images))}: outline and highlights determine the directions only to "
            f"{middle:.0f} degrees: give a mask or a circle, or light the background evenly"
        )
    unknown = np.flatnonzero(sigma_deg > _LARGEST_SIGMA_DEG)
    if len(unknown):
        more = f" (and {len(unknown) - 1} more lights)" if len(unknown) > 1 else ""
        raise EstimateError(
            f"light {names[unknown[0]]}{more}: its highlight on {places(list(images))} determines "
            f"the direction only to {sigma_deg[unknown[0]]:.0f} degrees, because a reflection may "
            "hide it: cover what shines, add a short exposure, or leave out its image"
        )


def _check_decided(names: tuple[str, ...], images: Sequence[SphereImage]) -> None:
    """Raise `EstimateError` if a light has only ambiguous highlights."""
    found = np.any([image.highlights.found for image in images], axis=0)
    for image in images:
        undecided = np.flatnonzero(image.highlights.ambiguous & ~found)
        if len(undecided):
            first = image.highlights.candidates.pixels[undecided[0], :2]
            where = " and ".join(f"({x:.0f}, {y:.0f})" for x, y in first)
            more = f" (and {len(undecided) - 1} more lights)" if len(undecided) > 1 else ""
            raise EstimateError(
                f"light {names[undecided[0]]}{more}: several bright spots on {places([image])} may "
                f"be its highlight, at {where} px: cover lamps and windows, or leave out its image"
            )
