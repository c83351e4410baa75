"""Reconstruction of normals and height from a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights, Source, setup_notices
from calibration import EstimateError, linear_stack, luma
from processing._mask import object_mask
from processing._metrics import AngularError, angular_error
from processing._reconstruction.colour_albedo import colour_albedo
from processing._reconstruction.colours import stereo_of_colours
from processing._reconstruction.curve_check import curve_warnings
from processing._reconstruction.error_bars import error_bars
from processing._reconstruction.heights import Heights
from processing._reconstruction.joint_colours import joint_stereo
from processing._reconstruction.light_strengths import (
    LightStrengths,
    light_strengths,
    of_source,
    with_strengths,
)
from processing._reconstruction.lit_images import lit_images
from processing._reconstruction.mosaic import (
    albedo_of_sites,
    blocks_of_sites,
    gray_picture,
)
from processing._reconstruction.near_height import NearHeight
from processing._reconstruction.quality import ImageQuality, image_quality
from processing._reconstruction.scheme_check import exclusion
from processing._reconstruction.specular import specular_residual
from processing._stereo.method import Method
from processing._stereo.photometric_stereo import PhotometricStereoResult, photometric_stereo
from processing._surface.height_map import HeightMap
from processing._surface.integration import integrate
from processing._uncertainty.normal_uncertainty import NormalUncertainty
from rig import Notice, Progress, check_type, no_progress

StereoChannel = Literal["gray", "rgb", "joint", "mosaic"]

# A computed mask beyond these probably contains background.
_LARGEST_SHARE = 0.8
_MOST_BORDERS = 3


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """The normals and the height of a recorded object, with the data they were computed from.

    Parameters
    ----------
    source
        The recording.
    lights
        The lights of the images that were used, in their order.
    mask
        ``(H, W)`` bool, the object: the mask of the source, or one computed from the images.
    stereo
        Normals of the valid pixels, gray albedo and residual.
    albedo
        ``(H, W, 3)`` float32 linear RGB if the images have colour, else the gray albedo
        ``(H, W)``; see `colour_albedo`. 0 outside the mask of the normals.
    uncertainty
        Standard deviations of the normals, what the samples show, and why pixels are not valid.
    specular
        ``(H, W)`` float32 mean light above a matte surface, see `specular_residual`.
    surface
        The height; None if it was not requested.
    quality
        Agreement of images, lights and normals.
    excluded
        Names of the images that were left out because they disagree with the others.
    strengths
        Strengths of the lights, if they were estimated.
    error
        Error of the normals over `mask`; None if the source has no ground truth.
    previews
        The first and the last linear image, each ``(H, W)`` float32.
    near_height
        Where the surface is, under near lights; None under distant lights.
    warnings
        Warnings about the source, the stack, the normals and the height.
    """

    source: Source
    lights: Lights
    mask: npt.NDArray[np.bool_]
    stereo: PhotometricStereoResult
    albedo: npt.NDArray[np.float32]
    uncertainty: NormalUncertainty
    specular: npt.NDArray[np.float32]
    surface: HeightMap | None
    quality: ImageQuality
    excluded: tuple[str, ...]
    strengths: LightStrengths | None
    error: AngularError | None
    previews: tuple[npt.NDArray[np.float32], ...]
    near_height: NearHeight | None
    warnings: tuple[Notice, ...]

    def __repr__(self) -> str:
        parts = [str(self.source.path), repr(self.stereo.normal_map)]
        if self.surface is not None:
            parts.append(f"height in {self.surface.unit}")
        if self.error is not None:
            parts.append(f"mean error {self.error.mae_deg:.2f} deg")
        return f"Reconstruction({', '.join(parts)})"


def reconstruct(
    source: Source,
    *,
    method: Method = "cauchy",
    channel: StereoChannel = "gray",
    distant: bool = False,
    height_mm: float | None = None,
    rests_on_plane: bool = False,
    exclude_disagreeing: bool = False,
    semi_calibrated: bool = False,
    surface: bool = True,
    on_progress: Progress = no_progress,
) -> Reconstruction:
    """Compute normals and height of a recorded object.

    The images are converted to linear radiance; a warning says if they fit the lights much better
    under another transfer curve, others if images, lights and normals do not agree (see
    `image_quality`), or if the lights were calibrated with another rig or camera. Images without
    light on the object are left out. Photometric stereo computes the normals, and their
    integration the height. Near lights are evaluated at the points of the surface: normals and
    height alternate, and the mean height is the one that explains the images best.

    Parameters
    ----------
    source
        Source with lights, as returned by `acquisition.read_source`. If it has no mask, one is
        computed from its images, see `object_mask`.
    method
        Method of `photometric_stereo`.
    channel
        ``gray``: normals from gray images, for which a mosaic is demosaiced. ``rgb``: one solution
        per channel; the normals are averaged with weights from the noise. ``joint``: one normal and
        one albedo per channel that explain the samples of all channels best. ``mosaic``: normals of
        every site of a Bayer mosaic from its own samples, without interpolation, so that edges of
        colours are as sharp as others; the albedo in colour is interpolated afterwards.
    distant
        Treat lights with positions as distant lights.
    height_mm
        Mean height of the object above the working plane, if it is known. Only for near lights.
    rests_on_plane
        The lowest points of the object are in the working plane. Only for near lights.
    exclude_disagreeing
        Leave out images that the other images contradict (see `image_quality`), unless so many do
        that it is not known which are right.
    semi_calibrated
        Estimate the strengths of the lights, relative to given intensities; see `light_strengths`.
    surface
        Also integrate the normals.
    on_progress
        Callback that receives the progress of the stages ``reading``, ``normals``, ``error bars``
        and, for images in colour, ``colour``.

    Returns
    -------
    Reconstruction
        Normals, height and the data they were computed from.

    Raises
    ------
    DataError
        If the source has no lights, or lights with positions and no camera with a working distance.
    EstimateError
        If the images or the lights do not determine the normals, or the normals face away from the
        camera.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights, read_source, write_png
    >>> from processing import reconstruct
    >>> lights = Lights(directions=[[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
    >>> y, x = np.mgrid[1:-1:24j, -1:1:24j]
    >>> normals = np.dstack([x, y, 0 * x + 2]) / np.sqrt(x**2 + y**2 + 4)[..., None]
    >>> ball = np.pad(normals @ lights.unit_directions.T, [(8, 8), (8, 8), (0, 0)])
    >>> for i in range(4):
    ...     write_png(f"ball.{i}.png", (60_000 * ball[:, :, i]).astype(np.uint16))
    >>> reconstruct(read_source(".", lights=lights))
    Reconstruction(., NormalMap(float32[40, 40, 3], 572 normals), height in px)
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    lights, points_mm = _light_geometry(source, distant=distant)
    if points_mm is None and (height_mm is not None or rests_on_plane):
        raise DataError(
            f"{source.path}: a height matters only under lights with positions: leave it out"
        )
    stack = linear_stack(
        source, channel="rgb" if channel == "joint" else channel, on_progress=on_progress
    )
    pattern = stack.pattern
    colour = channel in ("rgb", "joint")
    gray = luma(stack.values) if colour else stack.values
    warnings = [*source.warnings, *setup_notices(source), *stack.warnings]
    mask, elsewhere = stack.mask, source.not_object
    on_progress("normals", 0, 1)  # the images are examined first
    if mask is None:
        seen = gray if pattern is None else blocks_of_sites(gray)
        computed = object_mask(seen, outside=elsewhere)
        del seen
        mask = computed.mask
        text = (
            "the images have no mask: one was computed; the object is "
            f"{computed.contrast:.0f} times as bright as the background"
        )
        warnings.append(Notice("mask-estimated", text))
        warnings += _mask_warning(mask)
    elif elsewhere is not None:
        mask = mask & ~elsewhere
    lit = lit_images(gray, mask)
    if len(lit) < len(stack.ids):
        dark = [name for i, name in enumerate(stack.ids) if i not in lit]
        text = f"images left out because they show no light: {', '.join(dark)}"
        warnings.append(Notice("lights-unlit", text))
        stack, lights, gray = stack.take(lit), lights.take(lit), gray[lit]
    strengths = None
    if semi_calibrated:
        strengths = light_strengths(gray, lights, mask, points_mm=points_mm)
        stack, gray = strengths.divided(stack, gray)
    # Before the height, which a wrong curve would bend.
    warnings += curve_warnings(source, gray, lights, mask, points_mm)
    heights = Heights(source, mask, points_mm, height_mm, rests_on_plane, method, on_progress)
    near, points_mm = heights.of(gray, lights)
    if strengths is not None:
        # Of near lights, strengths and heights depend on each other.
        if near is not None:
            again = light_strengths(gray, lights, mask, points_mm=points_mm)
            stack, gray = again.divided(stack, gray)
            near, points_mm = heights.of(gray, lights)
            strengths = strengths.refined(again)
        lights = strengths.lights
        source = replace(source, lights=with_strengths(source.lights, lights))
        if source.lights is not None:
            strengths = of_source(strengths, source.lights)
        warnings += strengths.warnings
    quality = image_quality(gray, lights, mask, points_mm=points_mm)
    excluded: tuple[str, ...] = ()
    if exclude_disagreeing:
        kept = quality.scheme.agreeing(len(lights))
        excluded = tuple(name for i, name in enumerate(lights.ids) if i not in kept)
        warnings += exclusion(quality.scheme, lights.ids)
        if excluded:
            stack, lights, gray = stack.take(kept), lights.take(kept), gray[kept]
            near, points_mm = heights.of(gray, lights)
            quality = image_quality(gray, lights, mask, points_mm=points_mm)
    if near is not None:
        warnings += near.warnings
    warnings += quality.warnings
    previews = tuple(
        image.copy() if pattern is None else gray_picture(image, pattern)
        for image in (gray[0], gray[-1])
    )
    albedo = None
    if colour:
        del gray
        of_colours = joint_stereo if channel == "joint" else stereo_of_colours
        stereo, albedo = of_colours(
            stack.values,
            lights,
            mask,
            method=method,
            points_mm=points_mm,
            noise=stack.noise,
            camera=source.camera,
            on_progress=on_progress,
        )
    else:
        stereo = photometric_stereo(
            gray,
            lights,
            mask,
            method=method,
            points_mm=points_mm,
            noise=stack.noise,
            camera=source.camera,
            on_progress=on_progress,
        )
        del gray
    warnings += stereo.warnings
    stereo, uncertainty, doubts = error_bars(
        stack, lights, mask, stereo, albedo, points_mm, near, source.camera, on_progress
    )
    warnings += doubts
    _check_facing(source, stereo)
    specular = specular_residual(
        stack.values, lights, stereo, points_mm=points_mm, noise=stack.noise
    )
    used = stack.ids
    del stack  # by far the largest array; the height does not need it
    normal_map = stereo.normal_map
    if pattern is not None:
        albedo = albedo_of_sites(stereo.albedo, normal_map.mask, pattern)
        stereo = replace(stereo, albedo=luma(albedo))
    elif albedo is not None:
        albedo[~normal_map.mask] = 0
    else:
        albedo = colour_albedo(source, used, lights, stereo, points_mm, on_progress)
    height = None
    if surface:
        depth = None if near is None else near.depth
        height = integrate(
            normal_map, camera=source.camera, depth_mm=depth, sigma_deg=uncertainty.sigma_deg
        )
        warnings += height.warnings
    truth = source.normals_truth
    return Reconstruction(
        source=source,
        lights=lights,
        mask=mask,
        stereo=stereo,
        albedo=albedo,
        uncertainty=uncertainty,
        specular=specular,
        surface=height,
        quality=quality,
        excluded=excluded,
        strengths=strengths,
        error=None if truth is None else angular_error(normal_map, truth, mask),
        previews=previews,
        near_height=near,
        warnings=tuple(warnings),
    )


def _check_facing(source: Source, stereo: PhotometricStereoResult) -> None:
    normal_map = stereo.normal_map
    if float(np.mean(normal_map.normals[normal_map.mask, 2])) < 0:
        raise EstimateError(
            f"{source.path}: the normals face away from the camera: check that the light "
            "directions point from the object toward the lights, with z toward the camera"
        )


def _mask_warning(mask: npt.NDArray[np.bool_]) -> list[Notice]:
    """Return a warning about a computed mask that probably contains background."""
    share = float(mask.mean())
    touched = sum(bool(border.any()) for border in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))
    if share <= _LARGEST_SHARE and touched < _MOST_BORDERS:
        return []
    text = (
        f"the computed mask covers {share:.0%} of the image and touches {touched} of its borders: "
        "it probably contains background; give a mask"
    )
    return [Notice("mask-fills-frame", text)]


def _light_geometry(
    source: Source, *, distant: bool
) -> tuple[Lights, npt.NDArray[np.float64] | None]:
    """Return the lights to use, and the surface points that near lights require."""
    if source.lights is None:
        raise DataError(f"{source.path}: these images have no lights: add a lights file")
    lights = source.lights.distant() if distant else source.lights
    if not lights.near:
        return lights, None
    if source.camera is None or source.camera.working_distance_mm is None:
        raise DataError(
            f"{source.path}: lights with positions require a camera with a working distance: add a "
            "camera file, or treat the lights as distant"
        )
    return lights, source.camera.points_on_plane()
