"""Error bars of the normals of a recording, and the pixels that are valid."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from calibration import EstimateError
from processing._normal_map import NormalMap
from processing._reconstruction.near_height import NearHeight
from processing._reconstruction.views import View
from processing._stereo.photometric_stereo import PhotometricStereoResult
from processing._uncertainty.model_error import common_error, deviations
from processing._uncertainty.normal_uncertainty import (
    STRUCTURED,
    NormalUncertainty,
    in_degrees,
    sums_of,
    valid_errors,
)
from processing._uncertainty.pixel_variances import Origin, PixelVariances
from processing._uncertainty.sample_kind import Reason, SampleKind
from rig import Notice

Mask = npt.NDArray[np.bool_]

_WHY = {
    Reason.SATURATED: "saturated",
    Reason.SHADOW: "in shadow",
    Reason.OUTLIERS: "samples contradict each other",
    Reason.COPLANAR: "lit by lights in one plane",
}


class ErrorBarMaps:
    """Error bars of an image that are computed band by band.

    Parameters
    ----------
    shape
        ``(H, W)``.
    lights
        Number of lights.
    """

    def __init__(self, shape: tuple[int, ...], lights: int) -> None:
        self._total, self._common = (np.full(shape, np.nan, np.float32) for _ in range(2))
        self._samples: npt.NDArray[np.unsignedinteger] = np.zeros(
            (len(SampleKind), *shape), np.uint8 if lights < 256 else np.uint16
        )
        self._reason = np.zeros(shape, np.uint8)
        self._valid = np.zeros(shape, np.bool_)
        self._deviations, self._solved = np.zeros(shape[0]), np.zeros(shape[0], np.intp)

    def write(self, rows: slice, found: PixelVariances, inside: slice) -> None:
        """Copy rows of the variances of a band."""
        common, total = sums_of(found)
        self._common[rows], self._total[rows] = common[inside], total[inside]
        self._samples[:, rows] = found.samples[:, inside]
        self._reason[rows] = found.reason[inside]
        self._valid[rows] = valid_errors(found)[inside]
        sums, solved = deviations(found.model[inside], (found.noise + found.lights)[inside])
        self._deviations[rows], self._solved[rows] = sums, solved

    def finished(self, origin: Origin, correlation: float) -> NormalUncertainty:
        """Return the error bars after all bands; the maps are theirs then."""
        self._total += np.float32(common_error(self._deviations, self._solved))
        in_degrees(self._total, self._valid)
        in_degrees(self._common, self._valid)
        return NormalUncertainty(
            self._total, self._common, self._samples, self._reason, origin, correlation
        )


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
