"""Light directions as the mean of those that the spheres show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from acquisition import CameraModel, LightErrors, Lights, angle_deg
from acquisition.values import tangent_basis
from calibration._errors import EstimateError
from calibration.spheres.geometry.cone import Cone
from calibration.spheres.geometry.reflection import orthographic_directions, reflected_rays
from calibration.spheres.outline.outline_noise import outline_covariance
from calibration.spheres.outline.sphere_image import SphereImage, places
from calibration.spheres.solve.joint_refinement import KnownSpheres
from calibration.spheres.solve.lost_images import imprecise, left_out, undecided
from calibration.spheres.solve.sphere_calibration import (
    SeenTogether,
    Sphere,
    SphereCalibration,
    rms_deg,
)
from calibration.spheres.solve.sphere_positions import COMMON_SHARE, common_error, systematic
from rig import Notice
from rig.arrays import Float64, Intp

_DISAGREEMENT_DEG = 3.0
_STEP_PX = 1e-3
# Step of an outline relative to its error.
_STEP_SIGMAS = 0.01


def orthographic_lights(shown: SeenTogether, warnings: list[Notice]) -> SphereCalibration:
    """Return directions without a camera: every viewing ray is parallel to the axis."""
    outlines = [image.outline for image in shown.images]

    def rays_of(pixels: Float64, change: Float64) -> Float64:
        pairs = zip(outlines, np.moveaxis(pixels, 1, 0), change, strict=True)
        rays = [orthographic_directions(o.moved(by), of_one) for o, of_one, by in pairs]
        return np.stack(rays, axis=1)

    # Centre x, centre y and radius of each outline.
    common = np.zeros((len(outlines), 3))
    common[:, 2] = [COMMON_SHARE**0.5 * image.systematic_px for image in shown.images]
    pairs = zip(shown.images, common, strict=True)
    own = [outline_covariance(image) - np.outer(shared, shared) for image, shared in pairs]
    return _directions(shown, shown.spheres(), rays_of, own, common, warnings)


def perspective_lights(
    shown: SeenTogether,
    cones: Sequence[Cone],
    camera: CameraModel,
    warnings: list[Notice],
    placed: KnownSpheres | None = None,
) -> SphereCalibration:
    """Return directions seen from the centre of a sphere; ``placed`` is one of known radius."""
    centres = np.array([cone.axis / cone.sine for cone in cones])

    def rays_of(pixels: Float64, change: Float64) -> Float64:
        return reflected_rays(camera.rays(pixels), centres + change, 1.0)[1]

    if placed is None:
        own = [cone.covariance + systematic(cone, camera) for cone in cones]
        common = np.array([common_error(cone, camera) for cone in cones])
    else:
        own = [placed.covariance_mm2 / placed.radii_mm[0] ** 2]
        common = np.zeros((1, 3))
    return _directions(shown, shown.spheres(placed), rays_of, own, common, warnings)


def _directions(
    shown: SeenTogether,
    spheres: tuple[Sphere, ...],
    rays_of: Callable[[Float64, Float64], Float64],
    outline_covariances: list[Float64],
    outlines_common: Float64,
    warnings: list[Notice],
) -> SphereCalibration:
    """Average the directions that `rays_of` returns for highlights and changes of the outlines."""
    names, images = shown.lights, shown.images
    several = undecided(images)
    lights = np.delete(np.arange(len(names)), several)
    highlights = np.stack([image.highlights.pixels[lights] for image in images], axis=1)
    sigma_px = np.stack([image.highlights.sigma_px[lights] for image in images], axis=1)
    rays = rays_of(highlights, np.zeros((len(images), 3)))
    seen = np.isfinite(rays[..., 0])
    if not seen.any(axis=1).all():
        name = names[lights[int(np.argmin(seen.any(axis=1)))]]
        raise EstimateError(
            f"the highlight under light {name} is outside the sphere: check the outline"
        )
    _check_alike(images)
    covariances = direction_covariances(
        rays_of, highlights, sigma_px, np.array(outline_covariances), outlines_common
    )
    poor = imprecise(covariances, images)
    doubts = left_out(names, several, lights[poor], images)
    kept = np.delete(np.arange(len(lights)), poor)
    lights, highlights, seen = lights[kept], highlights[kept], seen[kept]
    rays, covariances = rays[kept], covariances[kept]
    directions = np.nansum(rays, axis=1)
    residuals = rms_deg(angle_deg(directions[:, None], rays), seen)
    residuals[seen.sum(axis=1) < 2] = np.nan
    if np.any(residuals > _DISAGREEMENT_DEG):
        worst = int(np.nanargmax(residuals))
        text = (
            f"the light directions of the spheres differ by up to {residuals[worst]:.1f} degrees "
            f"(light {names[lights[worst]]}), which the stated errors do not contain: the lights "
            "are near, or an outline is not that of a sphere; give a camera and a radius to get "
            "positions"
        )
        warnings.append(Notice("lights-near", text))
    warnings += doubts + _unlike(names, images, lights)
    errors = LightErrors(covariances, spheres=seen.sum(axis=1))
    ids = tuple(names[k] for k in lights)
    found = Lights(directions=directions, ids=ids, errors=errors)
    return SphereCalibration(found, spheres, highlights, seen, residuals, tuple(warnings))


def _unlike(names: tuple[str, ...], images: Sequence[SphereImage], lights: Intp) -> list[Notice]:
    """Return a notice for each sphere on which some lights have no highlight of the usual size."""
    notices = []
    for image in images:
        odd = [names[k] for k in image.highlights.unlike if k in lights]
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


def direction_covariances(
    rays_of: Callable[[Float64, Float64], Float64],
    highlights_px: Float64,
    sigma_px: Float64,
    outline_covariances: Float64,
    outlines_common: Float64,
) -> Float64:
    """Return the covariances of the mean directions of N lights, ``(N, 2, 2)`` in rad^2.

    Parameters
    ----------
    rays_of
        Function of highlights ``(N, K, 2)`` and changes ``(K, 3)`` of the parameters of the
        outlines that returns the directions ``(N, K, 3)``; NaN if there is no highlight.
    highlights_px
        ``(N, K, 2)``.
    sigma_px
        ``(N, K)`` standard deviations of each coordinate of a highlight.
    outline_covariances
        ``(K, 3, 3)`` covariances of the parameters of the outlines.
    outlines_common
        ``(K, 3)`` changes of the parameters by one standard deviation of an error that all outlines
        have in common, which the covariances do not contain.

    Returns
    -------
    Array
        In the basis of `acquisition.values.tangent_basis`. NaN where a change hides the highlight:
        there the light is seen at the rim.
    """
    none = np.zeros((highlights_px.shape[1], 3))
    rays = rays_of(highlights_px, none)
    seen = np.isfinite(rays[..., 0])
    total = np.where(seen[..., None], rays, 0.0).sum(axis=1)
    covariance = np.zeros((len(rays), 3, 3))

    def add(step: Float64, scale: Float64) -> None:
        slope = np.where(seen[..., None], step * scale, 0.0)
        covariance[:] += np.einsum("nka,nkb->nab", slope, slope)

    for shift in np.eye(2) * _STEP_PX:
        step = rays_of(highlights_px + shift, none) - rays_of(highlights_px - shift, none)
        add(step / (2 * _STEP_PX), sigma_px[..., None])
    values, vectors = np.linalg.eigh(outline_covariances)
    for axis in range(3):
        # One independent error of each outline: they change all at once, and add up separately.
        size = np.sqrt(np.maximum(values[:, axis], 0.0))
        change = _STEP_SIGMAS * size[:, None] * vectors[:, :, axis]
        step = rays_of(highlights_px, change) - rays_of(highlights_px, -change)
        add(step / (2 * _STEP_SIGMAS), np.ones(1))
    # The error that all outlines share adds up before it is squared.
    change = _STEP_SIGMAS * outlines_common
    step = rays_of(highlights_px, change) - rays_of(highlights_px, -change)
    slope = np.where(seen[..., None], step / (2 * _STEP_SIGMAS), 0.0).sum(axis=1)
    covariance += slope[:, :, None] * slope[:, None, :]
    basis = tangent_basis(total) / np.linalg.norm(total, axis=1)[:, None, None]
    return np.asarray(basis @ covariance @ basis.transpose(0, 2, 1), np.float64)
