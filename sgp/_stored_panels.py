"""Panels of a run whose maps are in files."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import numpy.typing as npt

import acquisition
from sgp._overview import Panel
from sgp._panels.crop import Crop
from sgp._panels.lights import lights_panel
from sgp._panels.maps import (
    image_panel,
    map_panel,
    shaded_panel,
    slopes_panel,
    vectors_panel,
)
from sgp._result import Result

Float = npt.NDArray[np.float32]

# Values that are read at once.
_READ = 4_000_000


def stored_panels(
    out: Path,
    lights: acquisition.Lights | None,
    results: Mapping[str, Result],
    unit: str,
    pixel_size: float,
    max_pixels: int,
) -> list[Panel]:
    """Return the overview pictures of a run from its files, without those of the images.

    Parameters
    ----------
    out
        Folder of the run.
    lights
        The lights of the images that were used.
    results
        Results by stage.
    unit, pixel_size
        Scale of the surface.
    max_pixels
        Most pixels of an image.
    """
    with ExitStack() as opened:

        def rows(stage: str, name: str) -> acquisition.MapRows:
            path = results[stage].outputs[name]
            return opened.enter_context(acquisition.ImageRows(path, max_pixels=max_pixels))

        albedo = rows("normals", "albedo")
        height, width = albedo.shape[:2]
        mask = acquisition.read_mask(out / "normals" / "mask.png", (height, width))
        crop = Crop.around(mask, pixel_size if unit == "mm" else None)
        pictures = [
            vectors_panel("normals (right red, up green)", rows("normals", "normals"), mask, crop),
            image_panel("albedo", albedo, crop, mask),
            _highlights(rows("normals", "specular"), albedo, mask, crop),
            _residual(rows("normals", "residual"), albedo, mask, crop),
            _samples(rows("normals", "used"), mask, crop, results["normals"]),
        ]
        sigma = results["normals"].metrics["normal_sigma_deg"]
        if sigma is not None:
            title = f"normals: standard deviation, median {sigma:.2g} deg"
            deviations = rows("normals", "normal_sigma_deg")
            pictures.append(map_panel(title, deviations, "deg", crop, error=True))
        heights = rows("surface", "height")
        shaded = "surface, lit from the upper left"
        pictures += [
            vectors_panel("shape component", rows("detail", "shape"), mask, crop),
            slopes_panel("detail component", rows("detail", "detail"), mask, crop),
            map_panel("height", heights, unit, crop),
            shaded_panel(shaded, heights, crop, pixel_size),
        ]
    if lights is not None:
        pictures.insert(0, lights_panel("lights, rings in degrees", lights, None))
    return pictures


def _highlights(
    specular: acquisition.MapRows,
    albedo: acquisition.MapRows,
    mask: npt.NDArray[np.bool_],
    crop: Crop,
) -> Panel:
    """Return a map of the light above a matte surface, relative to the mean albedo."""
    white, above = _mean(albedo, mask), _mean(specular, mask)
    percent = acquisition.ComputedRows(
        mask.shape, np.dtype(np.float32), lambda rows: 100 / white * specular[rows]
    )
    title = f"light above a matte surface, mean {100 * above / white:.2g} %"
    return map_panel(title, percent, "% of the mean albedo", crop, error=True, mask=mask)


def _residual(
    residual: acquisition.MapRows,
    albedo: acquisition.MapRows,
    mask: npt.NDArray[np.bool_],
    crop: Crop,
) -> Panel:
    """Return a map of the residual relative to the signal."""

    def percent(rows: slice) -> Float:
        found = np.zeros_like(residual[rows])
        signal = _gray(albedo[rows])
        np.divide(100 * residual[rows], signal, out=found, where=mask[rows] & (signal > 0))
        return found

    relative = acquisition.ComputedRows(mask.shape, np.dtype(np.float32), percent)
    middle = float(np.nanmedian(crop.picture(relative, mask)))
    title = f"residual, median {middle:.2g} %"
    return map_panel(title, relative, "% of the albedo", crop, error=True, mask=mask)


def _samples(
    used: acquisition.MapRows, mask: npt.NDArray[np.bool_], crop: Crop, normals: Result
) -> Panel:
    """Return a map of the number of samples."""
    inside = [used[rows][mask[rows]] for rows in _bands(mask)]
    least = int(min(part.min() for part in inside if part.size))
    most = int(max(part.max() for part in inside if part.size))
    count = normals.metrics["images"]
    counts = f"{most}" if least == most else f"{least} to {most}"
    title, limits = f"samples used, {counts} of {count}", (0.0, float(str(count)))
    return map_panel(title, used, "samples", crop, limits=limits, mask=mask)


def _mean(values: acquisition.MapRows, mask: npt.NDArray[np.bool_]) -> float:
    parts = (_gray(values[rows])[mask[rows]] for rows in _bands(mask))
    return sum(float(part.sum(dtype=np.float64)) for part in parts) / np.count_nonzero(mask)


def _gray(values: npt.NDArray[np.generic]) -> Float:
    floats = values.astype(np.float32)
    return floats if floats.ndim == 2 else floats.mean(axis=2, dtype=np.float32)


def _bands(mask: npt.NDArray[np.bool_]) -> list[slice]:
    height, width = mask.shape
    return acquisition.rows_in_bands(height, width, _READ)
