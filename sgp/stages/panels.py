"""Panels of the stages of a run, from maps in memory or in files."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

import acquisition
from rig.arrays import Bool, Float32, Generic
from sgp.pictures import (
    Crop,
    Masked,
    Panel,
    detail_panel,
    image_panel,
    lights_panel,
    map_panel,
    normals_panel,
    shaded_panel,
)
from sgp.results import NormalsMetrics

# The files of the stages that are drawn.
DRAWN = {
    "normals": ("normals", "albedo", "specular", "residual", "used", "normal_sigma_deg"),
    "detail": ("shape", "detail"),
    "surface": ("height",),
}
# Values that are read at once.
_READ = 4_000_000


def normals_panels(
    maps: Mapping[str, acquisition.MapRows],
    mask: Bool,
    crop: Crop,
    lights: acquisition.Lights,
    metrics: NormalsMetrics,
    true_lights: acquisition.Lights | None = None,
) -> list[Panel]:
    """Return pictures of the images and of their normals.

    Parameters
    ----------
    maps
        The maps of the normals by the names of their files; ``first`` and ``last``, the images of
        the first and the last light.
    mask
        Pixels with a normal.
    crop
        What is shown.
    lights
        Lights of the images that were used.
    metrics
        Figures of the normals.
    true_lights
        The true lights, if they are known.
    """
    lights_title = "lights" if true_lights is None else "lights (red: truth)"
    sigma = metrics["normal_sigma_deg"]
    panels = [
        image_panel(f"light {lights.ids[0]}", maps["first"], crop, mask),
        image_panel(f"light {lights.ids[-1]}", maps["last"], crop, mask),
        lights_panel(f"{lights_title}, rings in degrees", lights, true_lights),
        normals_panel("normals (right red, up green)", Masked(maps["normals"], mask), crop),
        image_panel("albedo", maps["albedo"], crop, mask),
        _highlights(maps["specular"], maps["albedo"], mask, crop),
        _residual(maps["residual"], maps["albedo"], mask, crop),
        _samples(maps["used"], mask, crop, len(lights)),
    ]
    if is_known(sigma):
        title = f"normals: standard deviation, median {sigma:.2g} deg"
        panels.append(map_panel(title, maps["normal_sigma_deg"], "deg", crop, error=True))
    return panels


def is_known(figure: float | None) -> bool:
    """Return whether a figure is a finite number."""
    return figure is not None and bool(np.isfinite(figure))


def error_panels(
    error_deg: acquisition.MapRows | None, metrics: NormalsMetrics, crop: Crop
) -> list[Panel]:
    """Return a picture of the errors of normals, if there is a ground truth."""
    if error_deg is None:
        return []
    title = f"normal error, mean {metrics['mae_deg']:.2f} deg"
    return [map_panel(title, error_deg, "deg", crop, error=True)]


def separation_panels(
    shape: acquisition.MapRows, detail: acquisition.MapRows, mask: Bool, crop: Crop
) -> list[Panel]:
    """Return pictures of the shape component and the detail component."""
    return [
        normals_panel("shape component", Masked(shape, mask), crop),
        detail_panel("detail component", Masked(detail, mask), crop),
    ]


def surface_panels(
    height: acquisition.MapRows, unit: str, pixel_size: float, crop: Crop
) -> list[Panel]:
    """Return pictures of a height map."""
    return [
        map_panel("height", height, unit, crop),
        shaded_panel("surface, lit from the upper left", height, crop, pixel_size),
    ]


def _highlights(
    specular: acquisition.MapRows, albedo: acquisition.MapRows, mask: Bool, crop: Crop
) -> Panel:
    """Return a map of the specular residual, relative to the mean albedo."""
    white, above = _mean(albedo, mask), _mean(specular, mask)
    percent = acquisition.files.ComputedRows(
        mask.shape, np.dtype(np.float32), lambda rows: 100 / white * specular[rows]
    )
    title = f"specular residual, mean {100 * above / white:.2g} %"
    return map_panel(title, percent, "% of the mean albedo", crop, error=True, mask=mask)


def _residual(
    residual: acquisition.MapRows, albedo: acquisition.MapRows, mask: Bool, crop: Crop
) -> Panel:
    """Return a map of the residual relative to the signal."""

    def percent(rows: slice) -> Float32:
        found = np.zeros_like(residual[rows])
        signal = _gray(albedo[rows])
        np.divide(100 * residual[rows], signal, out=found, where=mask[rows] & (signal > 0))
        return found

    relative = acquisition.files.ComputedRows(mask.shape, np.dtype(np.float32), percent)
    middle = float(np.nanmedian(crop.picture(relative, mask)))
    title = f"residual, median {middle:.2g} %"
    return map_panel(title, relative, "% of the albedo", crop, error=True, mask=mask)


def _samples(used: acquisition.MapRows, mask: Bool, crop: Crop, count: int) -> Panel:
    """Return a map of the number of samples."""
    inside = [used[rows][mask[rows]] for rows in _bands(mask)]
    least = int(min(part.min() for part in inside if part.size))
    most = int(max(part.max() for part in inside if part.size))
    counts = f"{most}" if least == most else f"{least} to {most}"
    title, limits = f"samples used, {counts} of {count}", (0.0, float(count))
    return map_panel(title, used, "samples", crop, limits=limits, mask=mask)


def _mean(values: acquisition.MapRows, mask: Bool) -> float:
    parts = (_gray(values[rows])[mask[rows]] for rows in _bands(mask))
    return sum(float(part.sum(dtype=np.float64)) for part in parts) / np.count_nonzero(mask)


def _gray(values: Generic) -> Float32:
    floats = values.astype(np.float32)
    return floats if floats.ndim == 2 else floats.mean(axis=2, dtype=np.float32)


def _bands(mask: Bool) -> list[slice]:
    height, width = mask.shape
    return acquisition.files.rows_in_bands(height, width, _READ)
