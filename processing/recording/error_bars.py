"""Error bars of the normals of a recording, and the pixels that are valid."""

from __future__ import annotations

import math

import numpy as np

from acquisition import CameraModel, MapRows
from acquisition.files import ComputedRows, Form, Maps
from calibration import EstimateError
from processing.checks.verdict import Verdict
from processing.images.viewing_rays import View
from processing.near.near_height import NearHeight
from processing.noise.normal_errors import STRUCTURED, in_degrees, sums_of, valid_reasons
from processing.noise.pixel_variances import SUMS, Origin, PixelVariances, common_error
from processing.noise.sample_kind import Reason, SampleKind
from processing.series.ambient_light import AmbientLight
from processing.stereo.normals_and_albedo import severity_of_loss
from rig import Notice
from rig.arrays import Bool, Float32, UInt8

_WHY = {
    Reason.SATURATED: "saturated",
    Reason.SHADOW: "in shadow",
    Reason.OUTLIERS: "samples contradict each other",
    Reason.COPLANAR: "lit by lights in one plane",
}


def error_bar_forms(shape: tuple[int, ...], lights: int) -> dict[str, Form]:
    """Return the maps that `ErrorBarMaps` fills, rows first."""
    height, width = shape
    return {
        "sigma": (shape, np.float32),
        "common_sigma": (shape, np.float32),
        "noise": (shape, np.float32),
        "samples": ((height, len(SampleKind), width), np.uint8 if lights < 256 else np.uint16),
        "reason": (shape, np.uint8),
        "sums": ((height, SUMS), np.float64),
    }


class ErrorBarMaps:
    """Error bars of an image that are computed band by band.

    Parameters
    ----------
    maps
        Maps of the forms of `error_bar_forms`. The first three hold variances.
    """

    def __init__(self, maps: Maps) -> None:
        self._maps = maps

    def write(
        self,
        rows: slice,
        found: PixelVariances,
        inside: slice,
        normals: Float32,
        ambient: AmbientLight | None,
    ) -> None:
        """Copy rows of the variances of a band, with those by the error of a constant light."""
        common, total = sums_of(found)
        if ambient is not None:
            shared = ambient.variance(normals)
            common, total = common + shared, total + shared
        for name, values in (
            ("sigma", total[inside]),
            ("common_sigma", common[inside]),
            ("noise", found.noise[inside]),
            ("samples", found.samples[:, inside].swapaxes(0, 1)),
            ("reason", found.reason[inside]),
            ("sums", found.sums[inside]),
        ):
            self._maps[name][rows] = values

    def common_variance(self) -> np.float32:
        """Return the variance that all pixels have besides their own, after all bands."""
        return np.float32(common_error(self._maps["sums"][:]))

    def by_residuals(self, common: np.float32, origin: Origin) -> MapRows:
        """Return standard deviations in degrees, without what leaves no residual.

        Parameters
        ----------
        common
            Variance that all pixels have besides their own.
        origin
            Where the law of the noise is from.
        """
        maps = self._maps

        def computed(rows: slice) -> Float32:
            variances: Float32 = maps["sigma"][rows] + common
            in_degrees(variances, valid_reasons(maps["reason"][rows], origin))
            return variances

        shape = maps["sigma"].shape
        return ComputedRows(shape, np.dtype(np.float32), computed)


def depth_deviation(
    near: NearHeight | None, view: View | None, mask: Bool
) -> tuple[CameraModel | None, float]:
    """Return a camera, and the relative standard deviation of all depths from it."""
    if view is None or near is None or not math.isfinite(near.mean_height_sigma_mm):
        return None, 0.0
    return view.depth_error(near.mean_height_sigma_mm, float(near.depth[mask].mean()))


def common_deg_of(verdict: Verdict) -> float:
    """Return what the causes of a verdict do to the normals, which no pixel averages away."""
    effects = [cause.normals_deg for cause in verdict.causes if math.isfinite(cause.normals_deg)]
    return math.hypot(*effects)


def check_any_valid(kept: Bool, reason: UInt8, solved: Bool) -> None:
    """Raise `EstimateError` with the reasons if no solved pixel is kept."""
    if not kept.any():
        raise EstimateError(
            "no pixel of the mask is lit by 3 lights that are not in one plane: most are "
            f"{_list_of(reason, solved)}; check the exposure, the lights and the mask"
        )


def _list_of(reasons: UInt8, inside: Bool) -> str:
    numbers = {reason: np.count_nonzero(inside & (reasons == reason)) for reason in _WHY}
    return ", ".join(
        f"{_WHY[reason]} ({number})"
        for reason, number in sorted(numbers.items(), key=lambda item: -item[1])
        if number
    )


def validity_notices(
    reasons: UInt8, mask: Bool, origin: Origin, correlation: float
) -> list[Notice]:
    """Return notices about pixels without a normal, and about the error bars."""
    notices = []
    why = _list_of(reasons, mask & (reasons != Reason.VALID))
    if why:
        lost = sum(int(np.count_nonzero(reasons == reason)) for reason in _WHY)
        total = int(np.count_nonzero(mask))
        text = (
            f"{lost} of {total} pixels of the mask are not lit by 3 lights that "
            f"determine a normal, and have none: {why}"
        )
        severity = severity_of_loss(lost, total)
        notices.append(Notice("pixels-invalid", text, severity=severity))
    if origin == "unknown":
        text = "too few samples of each pixel to estimate how sure the normals are"
        notices.append(Notice("normal-sigma-unknown", text, severity="info"))
    elif correlation > STRUCTURED:
        text = (
            "neighbouring lights have similar residuals (correlation "
            f"{correlation:.2f}; noise has less than {STRUCTURED:g}): the surface "
            "is not matte, or light comes from elsewhere; the standard deviations of the normals "
            "contain an estimate of these errors, to about a factor of 2"
        )
        notices.append(Notice("surface-not-matte", text, severity="info"))
    return notices
