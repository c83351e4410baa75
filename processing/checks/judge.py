"""Find what is probably wrong with a recording, and what it does to the normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from acquisition import Lights, Source
from calibration import EstimateError
from processing.checks.explanation import Explanation, explain
from processing.checks.quality import ImageQuality
from processing.checks.verdict import Cause, Verdict
from processing.images.block_means import cells_of
from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints, View
from processing.maps.metrics import angular_error
from processing.stereo.normals_and_albedo import photometric_stereo
from rig import Notice
from rig.arrays import Bool, Float64

_FEWEST_IMAGES = 4
# With these, sizes of other causes mean nothing, unless an arrangement of the lights explains them.
_DISTURBING = {"image-duplicate", "lights-shuffled"}
_ARRANGEMENTS = {"images-turned", "lights-mirrored", "lights-shuffled"}
# The distance of all lights has been compared with other causes.
_COMPARED = {"height-doubtful"}
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
    found = _explained(examined)
    known = {cause.name for cause in found.causes}
    if known & _ARRANGEMENTS:
        known |= _DISTURBING
    elif any(notice.code in _DISTURBING for notice in quality.warnings):
        found, known = replace(found, causes=()), set()
    if known:
        known.add("images-undecided")
    if found.tried:
        known |= _COMPARED
    others = [notice for notice in (*doubts, *quality.warnings) if notice.code not in known]
    causes = [*found.causes, *(_cause(examined, quality, notice) for notice in others)]
    # The causes that an unknown effect makes harmful, too, before smaller ones.
    causes.sort(key=lambda cause: -np.nan_to_num(cause.normals_deg, nan=np.inf))
    return Verdict(
        tuple(causes),
        sigma_deg=sigma_deg,
        residual=quality.residual,
        noise=quality.consistency,
        # Standard deviations contain an estimate of what residuals do.
        unexplained_deg=sigma_deg,
        tried=(*found.tried, *_tried(quality)),
        not_excluded=found.not_excluded,
        least=found.least,
    )


def _explained(examined: Examined) -> Explanation:
    images, lights, mask, points, view, source = examined
    cells = cells_of(images, mask, points)
    camera = source.camera
    pixel_mm = getattr(view, "pixel_mm", None)
    if camera is not None and camera.working_distance_mm is not None:
        pixel_mm = camera.working_distance_mm / float(camera.K[0, 0])
    return explain(cells, lights, _strengths(source, lights), view, pixel_mm)


def _strengths(source: Source, lights: Lights) -> Float64:
    """Return the signal of each image relative to its linear samples; the mean logarithm is 0."""
    exposures = dict.fromkeys(source.light_ids, 0.0)
    for frame in source.frames:
        if frame.role == "light" and frame.light_id in exposures:
            exposures[frame.light_id] = max(exposures[frame.light_id], frame.exposure_us or 0.0)
    times = np.array([exposures[name] for name in lights.ids])
    times = np.where(times > 0, times, times.max() or 1.0)
    strengths = times * np.asarray(lights.intensities).mean(axis=1)
    return np.asarray(strengths / np.exp(np.log(strengths).mean()))


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
