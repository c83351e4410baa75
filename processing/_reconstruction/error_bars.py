"""Error bars of the normals of a recording, and the pixels that are valid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel, Lights
from calibration import EstimateError, Stack
from processing._normal_map import NormalMap
from processing._reconstruction.near_height import NearHeight
from processing._reconstruction.views import View
from processing._stereo.photometric_stereo import PhotometricStereoResult
from processing._uncertainty.colours import uncertainty_of_colours
from processing._uncertainty.normal_uncertainty import (
    STRUCTURED,
    NormalUncertainty,
    normal_uncertainty,
)
from processing._uncertainty.sample_kind import Reason
from rig import Notice, Progress

Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_WHY = {
    Reason.SATURATED: "saturated",
    Reason.SHADOW: "in shadow",
    Reason.OUTLIERS: "samples contradict each other",
    Reason.COPLANAR: "lit by lights in one plane",
}


def error_bars(
    stack: Stack,
    lights: Lights,
    mask: Mask,
    stereo: PhotometricStereoResult,
    albedo: Float | None,
    points_mm: npt.NDArray[np.float64] | None,
    near: NearHeight | None,
    view: View | None,
    on_progress: Progress,
) -> tuple[PhotometricStereoResult, NormalUncertainty, list[Notice]]:
    """Return the result of photometric stereo at its valid pixels, its error bars, and notices.

    Parameters
    ----------
    stack, lights, mask, points_mm
        What the normals were computed from.
    stereo, albedo
        The normals; the albedo ``(H, W, 3)`` of channels that were solved on their own, else None.
    near, view
        Height of the object under near lights.

    Raises
    ------
    EstimateError
        If no pixel is valid.
    """
    camera, depth_sigma = depth_deviation(near, view, mask)
    if albedo is None:
        found = normal_uncertainty(
            stack.values,
            lights,
            mask,
            stereo,
            points_mm=points_mm,
            camera=camera,
            depth_sigma=depth_sigma,
            noise=stack.noise,
            on_progress=on_progress,
        )
    else:
        found = uncertainty_of_colours(
            stack.values,
            lights,
            mask,
            stereo,
            albedo,
            points_mm=points_mm,
            camera=camera,
            depth_sigma=depth_sigma,
            noise=stack.noise,
            on_progress=on_progress,
        )
    return judged(stereo, found, mask)


def judged(
    stereo: PhotometricStereoResult, found: NormalUncertainty, mask: Mask
) -> tuple[PhotometricStereoResult, NormalUncertainty, list[Notice]]:
    """Return normals at the valid pixels, their error bars, and notices."""
    return _valid_part(stereo, found), found, _notices(found, mask)


def depth_deviation(
    near: NearHeight | None, view: View | None, mask: Mask
) -> tuple[CameraModel | None, float]:
    """Return a camera, and the relative standard deviation of all depths from it."""
    if view is None or near is None or not math.isfinite(near.mean_height_sigma_mm):
        return None, 0.0
    return view.depth_error(near.mean_height_sigma_mm, float(near.depth[mask].mean()))


def _valid_part(
    stereo: PhotometricStereoResult, found: NormalUncertainty
) -> PhotometricStereoResult:
    solved = stereo.normal_map.mask
    kept = solved & found.valid
    if kept.all(where=solved):
        return stereo
    if not kept.any():
        raise EstimateError(
            "no pixel of the mask is lit by 3 lights that are not in one plane: most are "
            f"{_list_of(found, solved)}; check the exposure, the lights and the mask"
        )
    normals, maps = stereo.normal_map.normals.copy(), (stereo.albedo, stereo.residual)
    normals[~kept] = 0
    albedo, residual = (np.where(kept, values, np.float32(0)) for values in maps)
    return replace(stereo, normal_map=NormalMap(normals, kept), albedo=albedo, residual=residual)


def _list_of(found: NormalUncertainty, inside: Mask) -> str:
    numbers = {reason: np.count_nonzero(found.reason[inside] == reason) for reason in _WHY}
    return ", ".join(
        f"{_WHY[reason]} ({number})"
        for reason, number in sorted(numbers.items(), key=lambda item: -item[1])
        if number
    )


def _notices(found: NormalUncertainty, mask: Mask) -> list[Notice]:
    notices = []
    why = _list_of(found, mask & ~found.valid)
    if why:
        lost = int(np.count_nonzero(np.isin(found.reason, list(_WHY))))
        text = (
            f"{lost} of {np.count_nonzero(mask)} pixels of the mask are not lit by 3 lights that "
            f"determine a normal, and have none: {why}"
        )
        notices.append(Notice("pixels-invalid", text))
    if found.noise == "unknown":
        text = "too few samples of each pixel to estimate how sure the normals are"
        notices.append(Notice("normal-sigma-unknown", text, severity="info"))
    elif found.neighbour_correlation > STRUCTURED:
        text = (
            "neighbouring lights have similar residuals (correlation "
            f"{found.neighbour_correlation:.2f}; noise has less than {STRUCTURED:g}): the surface "
            "is not matte, or light comes from elsewhere; the standard deviations of the normals "
            "contain an estimate of these errors, to about a factor of 2"
        )
        notices.append(Notice("surface-not-matte", text, severity="info"))
    return notices
