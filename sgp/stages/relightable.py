"""Relightable images of a result: fitted to its images or its normals, written and drawn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

import acquisition
import processing
import rig
from rig.arrays import Bool, Float32, Float64
from sgp.pictures import Crop, image_panel, map_panel, write_overview
from sgp.results import Result, RtiMetrics, figures_of
from sgp.stages.options import RelightOptions
from sgp.stages.result_source import NormalsResult, open_source_of

# Rows and lights from which the deviations of the files are measured, at most.
_ROWS = 200
_LIGHTS = 24
_SHOWN = {"above": (0, 1, 0.7), "the right": (1, 0, 0.7), "the left": (-1, 0, 0.7),
          "below": (0, -1, 0.7)}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Relightable:
    """A fit and where it is from.

    Parameters
    ----------
    fit
        The image and its figures.
    fitted_to, directions
        As in `RtiMetrics`.
    lights
        ``(N, 3)`` directions of the lights.
    files
        Files that were read.
    notices
        What must be reported about the source.
    """

    fit: processing.relight.RelightFit
    fitted_to: Literal["images", "normals"]
    directions: Literal["distant", "surface", "plane"]
    lights: Float64
    files: list[Path]
    notices: list[rig.Notice]


def fit_result(
    path: Path,
    found: NormalsResult,
    normal_map: processing.NormalMap,
    options: RelightOptions,
    max_pixels: int,
    progress: rig.Progress,
) -> Relightable:
    """Fit the images of a result if its recording is there, else the shading of its normals.

    Raises
    ------
    DataError
        If a file of the recording has changed, or a file does not fit the others.
    """
    recorded = open_source_of(path, found, max_pixels)
    if recorded is None:
        return _of_normals(found, normal_map, options, max_pixels, progress)
    recording, pixel_mm = recorded
    source = recording.source
    if source.lights is None:
        raise acquisition.DataError(f"{source.path}: these images have no lights")
    distant = found.record.parameters.get("distant") is True
    near = source.lights.near and not distant
    depth = found.depth if near else None
    fit = processing.relight.fit_recording(
        source,
        **vars(options),
        distant=distant,
        depth_mm=None if depth is None else acquisition.read_image(depth, max_pixels=max_pixels),
        height_mm=found.height_mm(),
        pixel_mm=pixel_mm,
        on_progress=progress,
    )
    return Relightable(
        fit,
        "images",
        "distant" if not near else "plane" if depth is None else "surface",
        fit.directions,
        [*recording.files, *([] if depth is None else [depth])],
        list(source.warnings),
    )


def _of_normals(
    found: NormalsResult,
    normal_map: processing.NormalMap,
    options: RelightOptions,
    max_pixels: int,
    progress: rig.Progress,
) -> Relightable:
    albedo = found.folder / "albedo.exr"
    fit = processing.relight.fit_normals(
        normal_map,
        acquisition.read_image(albedo, max_pixels=max_pixels),
        **vars(options),
        on_progress=progress,
    )
    text = (
        "the recorded images of this result are gone: fitted to the shading of its normals and "
        "albedo, without gloss and cast shadows"
    )
    notice = rig.Notice("relit-from-normals", text, str(found.folder), "warning")
    return Relightable(fit, "normals", "distant", fit.directions, [albedo], [notice])


def write_relightable(
    folder: Path,
    made: Relightable,
    mask: Bool,
    options: RelightOptions,
    quality: int,
    about: Sequence[acquisition.Identity],
) -> Result:
    """Write the files of a relightable image into a folder and return them with their figures."""
    image, residual = made.fit.image, made.fit.residual
    result = Result(warnings=made.notices)
    files, stored = processing.relight.write_rti_planes(
        folder, image, made.lights, quality=quality, recordings=about
    )
    result.outputs |= {path.stem: path for path in files}
    planes = _difference(image, stored, made.lights)
    inside = mask & np.isfinite(residual)
    metrics = figures_of(
        RtiMetrics,
        made,
        lights=len(made.lights),
        coefficients=image.coefficients.shape[2],
        pixels=int(np.count_nonzero(mask)),
        pixels_without_samples=made.fit.without_samples,
        white=made.fit.white,
        fit_rms=float(np.median(residual[inside])) if inside.any() else float("nan"),
        planes_rms=planes[0],
    )
    height, width = image.size
    kind = "images" if made.fitted_to == "images" else "shading of normals"
    result.summary = [
        f"{width} x {height} pixels, {image.basis} {options.colours}, fitted to {kind} under "
        f"{len(made.lights)} lights",
        f"fit {255 * metrics['fit_rms']:.1f} of 255 rms (median of the object)",
        f"planes within {planes[0]:.2f} of 255 rms of the fit",
    ]
    if image.basis == "ptm":
        added = _difference(
            image,
            processing.relight.write_ptm(result.file("ptm", folder / "relight.ptm"), image),
            made.lights,
        )
        metrics["ptm_rms"], metrics["ptm_largest"] = added
        result.summary.append(
            f"relight.ptm within {added[0]:.2f} of 255 rms of the fit, {added[1]:.1f} at most"
        )
    acquisition.write_exr(result.file("fit_rms", folder / "fit_rms.exr"), residual)
    _draw(result.file("picture", folder / "relit.png"), stored, residual, mask, options)
    result.metrics = metrics
    return result


def _difference(
    image: processing.relight.RelightableImage,
    stored: processing.relight.RelightableImage,
    lights: Float64,
) -> tuple[float, float]:
    """Return rms and largest deviation of shown values, 0 to 255, in some rows under some lights.

    Values that viewers show as black or white count as these.
    """
    step = 1 + len(image.coefficients) // _ROWS
    one, other = (
        replace(
            which,
            coefficients=which.coefficients[::step],
            colour=None if which.colour is None else which.colour[::step],
        )
        for which in (image, stored)
    )
    total, largest, count = 0.0, 0.0, 0
    for light in lights[:: 1 + len(lights) // _LIGHTS]:
        shown = (np.clip(which.relit(light), 0, 1) for which in (one, other))
        left = 255 * np.subtract(*shown)
        total += float(np.sum(left * left, dtype=np.float64))
        largest = max(largest, float(np.abs(left).max()))
        count += left.size
    return float(np.sqrt(total / count)), largest


def _draw(
    path: Path,
    image: processing.relight.RelightableImage,
    residual: Float32,
    mask: Bool,
    options: RelightOptions,
) -> None:
    """Draw the image, as it is in the files, under four lights, and the deviation of the fit.

    Viewers average the coefficients, too, where they show several pixels as one.
    """
    crop = Crop.around(mask)
    planes = image.coefficients.reshape(*mask.shape, -1)
    reduced = np.dstack([crop.picture(planes[..., k]) for k in range(planes.shape[2])])
    small = replace(
        image,
        coefficients=reduced.reshape(*reduced.shape[:2], *image.coefficients.shape[2:]),
        colour=None if image.colour is None else crop.picture(image.colour),
    )
    rows, columns = small.size
    complete = Crop(slice(0, rows), slice(0, columns))
    panels = []
    for side, direction in _SHOWN.items():
        shown = np.clip(small.relit(direction), 0, 1)
        if options.values == "display":
            shown = acquisition.SRGB.light(shown).astype(np.float32)
        panels.append(image_panel(f"light from {side}", shown, complete))
    title = "deviation of the fit, rms over the lights"
    percent = 100 * residual
    panels.append(map_panel(title, percent, "% of white", crop, error=True, mask=mask))
    write_overview(path, "As viewers show it", panels, columns=3)
