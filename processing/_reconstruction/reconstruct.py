"""Reconstruction of normals and height from a recording."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import DataError, Lights, Source, setup_notices
from calibration import EstimateError, linear_stack, luma
from processing._metrics import angular_error
from processing._reconstruction.colour_albedo import colour_albedo
from processing._reconstruction.colours import stereo_of_colours
from processing._reconstruction.error_bars import error_bars
from processing._reconstruction.examination import Examination
from processing._reconstruction.heights import Heights
from processing._reconstruction.joint_colours import joint_stereo
from processing._reconstruction.mosaic import albedo_of_sites, gray_picture
from processing._reconstruction.object_of_images import object_of
from processing._reconstruction.reconstruction import Reconstruction
from processing._reconstruction.specular import specular_residual
from processing._stereo.method import Method
from processing._stereo.photometric_stereo import PhotometricStereoResult, photometric_stereo
from processing._surface.integration import integrate
from rig import Progress, check_type, no_progress

StereoChannel = Literal["gray", "rgb", "joint", "mosaic"]


def reconstruct(
    source: Source,
    *,
    method: Method = "best",
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
    on_progress("normals", 0, 1)  # the images are examined first
    mask, doubts = object_of(gray, stack.mask, source.not_object, pattern)
    warnings += doubts
    examined = Examination(
        source,
        stack,
        gray,
        lights,
        mask,
        Heights(source, mask, points_mm, height_mm, rests_on_plane, method, on_progress),
        points_mm,
    )
    del stack, gray  # the examination may replace them
    examined.leave_out_unlit()
    examined.find_surface(semi_calibrated=semi_calibrated)
    quality = examined.check(exclude_disagreeing=exclude_disagreeing)
    warnings += examined.warnings
    source, lights, near = examined.source, examined.lights, examined.near
    stack, gray, points_mm = examined.stack, examined.gray, examined.points_mm
    strengths, excluded = examined.strengths, examined.excluded
    del examined
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
        height = integrate(normal_map, camera=source.camera, depth_mm=depth)
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
