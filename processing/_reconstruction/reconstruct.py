"""Reconstruction of normals and height from a recording."""

from __future__ import annotations

import math
from contextlib import ExitStack
from dataclasses import replace
from typing import Literal

import numpy as np

from acquisition import Source, setup_notices
from calibration import BandedStack, Channel, Stack, linear_stack, luma, open_stack
from processing._metrics import angular_error
from processing._reconstruction.banded_normals import normals_in_bands
from processing._reconstruction.colour_albedo import colour_albedo
from processing._reconstruction.colour_normals import colours_in_bands
from processing._reconstruction.examined import (
    check_facing,
    examination_of,
    geometry_of,
)
from processing._reconstruction.mosaic import albedo_of_sites, gray_picture
from processing._reconstruction.reconstruction import Reconstruction
from processing._reconstruction.views import Perspective
from processing._stereo.method import Method
from processing._surface.integration import integrate
from rig import Progress, check_type, no_progress

StereoChannel = Literal["gray", "rgb", "joint", "mosaic"]

# Bytes of a stack that is read at once; a larger one is solved in bands of rows.
_IN_MEMORY = 1_000_000_000


def reconstruct(
    source: Source,
    *,
    method: Method = "best",
    channel: StereoChannel = "gray",
    distant: bool = False,
    height_mm: float | None = None,
    rests_on_plane: bool = False,
    pixel_mm: float | None = None,
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
    pixel_mm
        Distance between neighbouring pixels on the object, if the source has no camera with a
        working distance. Without a camera, the view is orthographic.
    exclude_disagreeing
        Leave out images that the other images contradict (see `image_quality`), unless so many do
        that it is not known which are right.
    semi_calibrated
        Estimate the strengths of the lights, relative to given intensities; see `light_strengths`.
    surface
        Also integrate the normals.
    on_progress
        Callback that receives the progress of the stages ``reading``, ``normals`` and, for images
        in colour, ``error bars`` and ``colour``.

    Returns
    -------
    Reconstruction
        Normals, height and the data they were computed from.

    Raises
    ------
    DataError
        If the source has no lights, or lights with positions and no scale: neither a camera with a
        working distance nor a size of its pixels.
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
    geometry = geometry_of(
        source, pixel_mm, height_mm, rests_on_plane=rests_on_plane, distant=distant
    )
    with ExitStack() as opened:
        stack = _opened(source, channel, opened, on_progress, whole=semi_calibrated)
        pattern = stack.pattern
        examined, of_mask = examination_of(source, stack, geometry, method, on_progress)
        del stack  # the examination may replace it
        examined.leave_out_unlit()
        examined.find_surface(semi_calibrated=semi_calibrated)
        quality = examined.check(exclude_disagreeing=exclude_disagreeing)
        previews = tuple(
            np.array(image) if pattern is None else gray_picture(image, pattern)
            for image in (examined.images[0], examined.images[-1])
        )
        if examined.images.in_colour:
            solved, albedo = colours_in_bands(
                examined, method, on_progress, joint=channel == "joint"
            )
        else:
            solved, albedo = normals_in_bands(examined, method, on_progress), None
        warnings = [
            *source.warnings,
            *setup_notices(source),
            *examined.images.warnings,
            *of_mask,
            *examined.warnings,
            *solved.warnings,
        ]
        source, lights, near = examined.source, examined.lights, examined.near
        mask, view = examined.mask, geometry.view
        points, used = examined.points, examined.images.ids
        strengths, excluded = examined.strengths, examined.excluded
        del examined  # by far the largest arrays; the height does not need them
    stereo = solved.stereo
    normal_map = stereo.normal_map
    check_facing(source, float(np.mean(normal_map.normals[..., 2][normal_map.mask])))
    if pattern is not None:
        albedo = albedo_of_sites(stereo.albedo, normal_map.mask, pattern)
        stereo = replace(stereo, albedo=luma(albedo))
    elif albedo is not None:
        albedo[~normal_map.mask] = 0
    else:
        albedo = colour_albedo(source, used, lights, stereo, points, on_progress)
    height = None
    if surface:
        depth = None if near is None else near.depth
        camera, size = source.camera, pixel_mm
        if isinstance(view, Perspective):
            camera, size = view.camera, None  # the camera has the scale
        height = integrate(normal_map, camera=camera, pixel_mm=size, depth_mm=depth)
        warnings += height.warnings
    truth = source.normals_truth
    return Reconstruction(
        source=source,
        lights=lights,
        mask=mask,
        stereo=stereo,
        albedo=albedo,
        uncertainty=solved.uncertainty,
        specular=solved.specular,
        surface=height,
        quality=quality,
        excluded=excluded,
        strengths=strengths,
        error=None if truth is None else angular_error(normal_map, truth, mask),
        previews=previews,
        near_height=near,
        warnings=tuple(warnings),
    )


def _opened(
    source: Source, channel: StereoChannel, opened: ExitStack, on_progress: Progress, *, whole: bool
) -> Stack | BandedStack:
    """Return the stack of a source, on disk if it is large and the complete one is not needed."""
    of_stack: Channel = "rgb" if channel == "joint" else channel
    values = len(source.light_ids) * math.prod(source.size) * (3 if of_stack == "rgb" else 1)
    if whole or 4 * values <= _IN_MEMORY:
        return linear_stack(source, channel=of_stack, on_progress=on_progress)
    return opened.enter_context(open_stack(source, channel=of_stack, on_progress=on_progress))
