"""Find what is probably wrong with a recording, and what it does to the normals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from acquisition import Lights, Source
from calibration import EstimateError
from processing.checks.quality import ImageQuality
from processing.checks.verdict import Cause, Verdict
from processing.images.block_means import cells_of
from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints, View
from processing.maps.metrics import angular_error
from processing.stereo.normals_and_albedo import photometric_stereo
from rig import Notice
from rig.arrays import Bool

_FEWEST_IMAGES = 4
_REMEDIES = {
    "image-disagrees": "look at the image, record it again, or leave it out",
    "lights-mirrored": "check the axes of the lights",
    "lights-shuffled": "check the order of images and lights",
}


class Examined(NamedTuple):
    """A recording, and with what its normals were computed.

    Parameters
    ----------
    images
        The N images that are used.
    lights
        Their N lights.
    mask
        ``(H, W)`` bool, the object.
    points
        Points of the surface; None under distant lights.
    view
        How pixels see these points; None under distant lights.
    source
        The recording.
    """

    images: Images
    lights: Lights
    mask: Bool
    points: SurfacePoints | None
    view: View | None
    source: Source


def judge(
    examined: Examined, quality: ImageQuality, doubts: Sequence[Notice], sigma_deg: float
) -> Verdict:
    """Return what is probably wrong with a recording.

    Parameters
    ----------
    examined
        Images, lights and points.
    quality
        Agreement of the images with their lights and with each other.
    doubts
        What contradicts the transfer curve or the height.
    sigma_deg
        Stated standard deviation of the normals: the median, in degrees; NaN if it is not known.
    """
    causes = [_cause(examined, quality, notice) for notice in (*doubts, *quality.warnings)]
    # The causes that an unknown effect makes harmful, too, before smaller ones.
    causes.sort(key=lambda cause: -np.nan_to_num(cause.normals_deg, nan=np.inf))
    return Verdict(
        tuple(causes),
        sigma_deg=sigma_deg,
        residual=quality.residual,
        noise=quality.consistency,
        tried=_tried(quality),
    )


def _tried(quality: ImageQuality) -> tuple[str, ...]:
    tested = {
        "lights-mirrored": not np.isnan(quality.curl),
        "lights-shuffled": bool(np.isfinite(quality.light_error_deg).any()),
    }
    return tuple(name for name, done in tested.items() if done)


def _cause(examined: Examined, quality: ImageQuality, notice: Notice) -> Cause:
    text, _, remedy = notice.text.rpartition("; ")
    if notice.code in _REMEDIES or not text:
        text, remedy = notice.text, _REMEDIES.get(notice.code, "")
    effect = np.nan
    if notice.code == "lights-shuffled":
        known = quality.light_error_deg[np.isfinite(quality.light_error_deg)]
        effect = float(np.median(known)) if len(known) else np.nan
    elif notice.where:
        effect = _without(examined, notice.where.split(", "))
    return Cause(
        name=notice.code,
        text=text,
        size=np.nan,
        unit="",
        sigma=np.nan,
        normals_deg=effect,
        height_mm=np.nan,
        remedy=remedy,
        inverts=notice.code == "lights-mirrored",
        where=notice.where,
    )


def _without(examined: Examined, ids: Sequence[str]) -> float:
    """Return the rms change of the normals, in degrees, if some images are left out."""
    images, lights, mask, points, _, _ = examined
    kept = [i for i, name in enumerate(lights.ids) if name not in ids]
    if not _FEWEST_IMAGES <= len(kept) < len(lights):
        return np.nan
    cells = cells_of(images, mask, points)
    try:
        every, others = (
            photometric_stereo(
                cells.values[some],
                lights.take(some),
                cells.mask,
                method="cauchy",
                points_mm=cells.points_mm,
            ).normal_map
            for some in (list(range(len(lights))), kept)
        )
    except EstimateError:
        return np.nan
    both = every.mask & others.mask
    if not both.any():
        return np.nan
    change = angular_error(every, others.normals, both).map_deg[both]
    return float(np.sqrt(np.mean(np.square(change, dtype=np.float64))))
