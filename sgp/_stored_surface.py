"""A surface that is larger than memory: solved in blocks, written in bands of rows."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

import acquisition
import processing
import rig
from sgp._camera_doubts import camera_notices
from sgp._console import Stages, shown
from sgp._exit import UsageError
from sgp._memory_limit import size_text
from sgp._output import claim_folder
from sgp._result import Result
from sgp._sigma_map import store_sigma
from sgp._stage_metrics import SurfaceMetrics
from sgp._stage_options import SurfaceOptions
from sgp._surface_memory import SurfaceWay
from sgp._write_surface import (
    add_camera,
    residual_lines,
    surface_lines,
    write_height_maps,
)

_BAND = 1 << 25  # bytes of rows with what is computed of them


@dataclass(frozen=True, kw_only=True)
class SurfaceInputs:
    """The files from which a surface is computed, as `sgp surface` takes them."""

    normals: Path
    mask: Path | None
    albedo: Path | None
    camera: Path | None
    sigma: Path | None
    mean_depth_mm: Callable[[acquisition.CameraModel | None], float | None]
    green: Literal["up", "down"]
    max_pixels: int


def stored_surface(
    inputs: SurfaceInputs, options: SurfaceOptions, way: SurfaceWay, out: Path
) -> Result:
    """Solve a surface in blocks and write its files; temporary files are in the output folder.

    Raises
    ------
    DataError
        If the disk has too little space, besides the errors of the readers and the solver.
    """
    place = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    free = shutil.disk_usage(place).free
    if free < way.disk:
        raise acquisition.DataError(
            f"{out}: the surface needs about {size_text(way.disk)} of disk while it is computed, "
            f"{size_text(free)} are free: free space, or choose another disk"
        )
    forms = dict.fromkeys(("curl", "residual"), (way.size, np.float32))
    # Files of a process that was killed are written again.
    identity = {"command": "sgp surface"}
    with ExitStack() as opened:
        store = opened.enter_context(
            acquisition.BandStore(out / "surface", identity, forms, replace=True)
        )
        try:
            return _computed(inputs, options, way, out, store, opened)
        finally:
            store.remove()
            with suppress(OSError):
                out.rmdir()  # if nothing was written


def _computed(
    inputs: SurfaceInputs,
    options: SurfaceOptions,
    way: SurfaceWay,
    out: Path,
    store: acquisition.BandStore,
    opened: ExitStack,
) -> Result:
    folder, rows = store.folder, way.rows
    if rows is None:
        raise UsageError("a surface in blocks needs a number of rows")
    with Stages() as progress:
        progress("reading normals", 0, 1)
        read = processing.store_normals(
            inputs.normals,
            folder / "normals.raw",
            green=inputs.green,
            max_pixels=inputs.max_pixels,
        )
        progress("reading normals", 1, 1)
    opened.callback(read.normals.close)
    notices, mask, normals = [*read.warnings], read.mask, read.normals
    vectors: acquisition.MapRows = normals
    if inputs.mask is not None:
        mask, more = masked(inputs.mask, mask, inputs.normals)
        notices += more
        vectors = acquisition.ComputedRows(
            normals.shape, normals.dtype, lambda part: normals[part] * mask[part][..., None]
        )
    model = None
    if inputs.camera is not None:
        model = acquisition.read_camera(inputs.camera, way.size)
        notices += camera_notices(inputs.camera, model)
    sigma = None
    if inputs.sigma is not None:
        deviations = store_sigma(inputs.sigma, mask, folder / "sigma.raw", inputs.max_pixels)
        notices += deviations.notices
        sigma = deviations.sigma_deg
        opened.callback(sigma.close)
    with Stages() as progress:
        surface = processing.integrate_in_blocks(
            vectors,
            mask,
            folder,
            rows=rows,
            camera=model,
            pixel_mm=options.pixel_mm,
            mean_depth_mm=inputs.mean_depth_mm(model),
            sigma_deg=sigma,
            on_progress=progress,
        )
    opened.callback(surface.close)
    bands = acquisition.rows_in_bands(way.size[0], 400 * way.size[1], _BAND)
    for part in shown("comparing with the normals", bands):
        store["residual"][part] = processing.residual_of_rows(surface, vectors, part)
    curl = processing.curl_in_rows(vectors, mask, store["curl"], model, sigma)
    colours = None
    if inputs.albedo is not None:
        image = opened.enter_context(
            acquisition.ImageRows(inputs.albedo, max_pixels=inputs.max_pixels)
        )
        colours = _colour_rows(inputs.albedo, image, mask)
    # Results of an earlier command are removed only now.
    claimed = claim_folder(out, "surface.json")
    metrics = _metrics(surface)
    extremes = surface.lowest, surface.highest
    result = write_height_maps(claimed, surface, extremes, curl, store["residual"], metrics)
    result.warnings = [*notices, *surface.warnings, *result.warnings]
    for suffix in shown("writing meshes", options.formats()):
        path = result.outputs[suffix] = claimed / f"surface.{suffix}"
        processing.write_mesh_rows(path, surface, normals=vectors, colours=colours)
    result.metrics = metrics
    result.summary = [
        *surface_lines(metrics),
        f"solved in {surface.blocks} blocks of rows: differs from the surface of the whole by at "
        f"most {surface.error:.2g} {surface.unit} (estimated)",
        *residual_lines(metrics),
    ]
    given = (inputs.mask, inputs.albedo, inputs.camera, inputs.sigma)
    result.inputs = [*read.files, *(path for path in given if path is not None)]
    return result


def masked(
    path: Path, known: npt.NDArray[np.bool_], normals: Path
) -> tuple[npt.NDArray[np.bool_], list[rig.Notice]]:
    """Return the pixels of a mask that have a normal, and a notice about the others."""
    height, width = known.shape
    wanted = acquisition.read_mask(path, (height, width))
    inside = wanted & known
    lost = int(np.count_nonzero(wanted & ~inside))
    if not lost:
        return inside, []
    have = "pixel of the mask has", "pixels of the mask have"
    text = f"{rig.pluralize(lost, *have)} no normal in {normals}, and no height"
    return inside, [rig.Notice("normals-not-unit", text, str(path), "info")]


def _metrics(surface: processing.BlockSurface) -> SurfaceMetrics:
    metrics: SurfaceMetrics = {
        "unit": surface.unit,
        "pixel_size": surface.pixel_size,
        "height_range": float(np.float32(surface.highest) - np.float32(surface.lowest)),
        "vertices": surface.pixels,
        "parts": surface.part_count,
        "iterations": surface.iterations,
        "disagreement_deg": surface.disagreement_deg,
        "curl": None if np.isnan(surface.curl) else surface.curl,
        "blocks": surface.blocks,
        "block_rounds": surface.rounds,
        "block_error": surface.error,
    }
    add_camera(metrics, surface)
    return metrics


def _colour_rows(
    path: Path, image: acquisition.ImageRows, mask: npt.NDArray[np.bool_]
) -> acquisition.MapRows:
    """Return sRGB samples: floats are linear albedo, other samples are sRGB."""
    check_colours(path, image.shape, mask.shape)
    if image.dtype == np.uint8:
        return image
    kind = np.dtype(np.uint8)
    if image.dtype == np.uint16:
        return acquisition.ComputedRows(
            image.shape, kind, lambda rows: np.rint(image[rows] / 257).astype(kind)
        )
    white = processing.albedo_white(image, mask)
    return acquisition.ComputedRows(
        image.shape, kind, lambda rows: processing.albedo_samples(image[rows], mask[rows], white)
    )


def check_colours(path: Path, shape: tuple[int, ...], size: tuple[int, ...]) -> None:
    """Refuse colours of another size than the normals.

    Raises
    ------
    DataError
        If they differ.
    """
    if shape[:2] != size:
        raise acquisition.DataError(
            f"{path}: {shape[1]} x {shape[0]} pixels, but the normals have {size[1]} x "
            f"{size[0]}: give an image of the same size"
        )
