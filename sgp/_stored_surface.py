"""A surface that is larger than memory: solved in blocks, written in bands of rows."""

from __future__ import annotations

import shutil
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

import acquisition
import calibration
import processing
import rig
from sgp._console import Stages, shown
from sgp._exit import UsageError
from sgp._hashes import sha256
from sgp._memory_limit import identity, other_maps_refused, size_text
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
    """What a surface is computed from.

    Parameters
    ----------
    normals, mask, albedo, sigma, green, max_pixels
        As `sgp surface` takes them.
    camera
        The perspective camera; None for an orthographic surface.
    pixel_mm
        Size of a pixel on the object.
    depth_mm
        ``(H, W)`` approximate depth, as for `processing.integrate`.
    weighted
        Whether normals count by ``sigma``, which otherwise only serves to judge their curl.
    """

    normals: Path
    mask: Path | None = None
    albedo: Path | None = None
    camera: acquisition.CameraModel | None = None
    sigma: Path | None = None
    pixel_mm: float | None = None
    depth_mm: acquisition.MapRows | None = None
    weighted: bool = True
    green: Literal["up", "down"] = "up"
    max_pixels: int


def stored_surface(
    inputs: SurfaceInputs, options: SurfaceOptions, way: SurfaceWay, out: Path, *, force: bool
) -> Result:
    """Solve a surface in blocks and write its files; temporary files are in the output folder.

    The blocks that an earlier process solved from the same inputs are not solved again.

    Parameters
    ----------
    inputs, options, way, out
        What is computed, how, and where.
    force
        Whether blocks of other inputs are removed.

    Raises
    ------
    StorageError
        If the disk has too little space, besides the errors of the readers and the solver.
    UsageError
        If there are blocks of other inputs.
    """
    depends_on = _identity(inputs)
    if not force:
        with other_maps_refused():
            acquisition.check_unfinished(out / "surface", depends_on)
    place = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
    free = shutil.disk_usage(place).free
    if free < way.disk and not acquisition.is_unfinished(out / "surface"):
        raise acquisition.StorageError(
            f"{out}: the surface needs about {size_text(way.disk)} of disk while it is computed, "
            f"{size_text(free)} are free: free space, or choose another disk"
        )
    forms = dict.fromkeys(("curl", "residual"), (way.size, np.float32))
    with ExitStack() as opened:
        store = opened.enter_context(
            acquisition.BandStore(out / "surface", depends_on, forms, replace=force)
        )
        try:
            result = _computed(inputs, options, way, out, store, opened)
        except (acquisition.DataError, calibration.EstimateError, UsageError):
            # These inputs have no surface: there is nothing to continue.
            store.remove()
            with suppress(OSError):
                out.rmdir()
            raise
        store.remove()
        return result


def _identity(inputs: SurfaceInputs) -> dict[str, object]:
    """Return what the solutions of blocks depend on."""
    found = processing.find_normals(inputs.normals, max_pixels=inputs.max_pixels)
    weights = inputs.sigma if inputs.weighted else None
    given = {
        "green": inputs.green,
        "camera": None if inputs.camera is None else asdict(inputs.camera),
        "mask": None if inputs.mask is None else sha256(inputs.mask),
        "sigma": None if weights is None else sha256(weights),
    }
    return identity(given, list(found.files))


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
    sigma: acquisition.MapRows | None = None
    if inputs.sigma is not None:
        if inputs.weighted:
            deviations = store_sigma(inputs.sigma, mask, folder / "sigma.raw", inputs.max_pixels)
            notices += deviations.notices
            opened.callback(deviations.sigma_deg.close)
            sigma = deviations.sigma_deg
        else:
            sigma = opened.enter_context(
                acquisition.ImageRows(inputs.sigma, max_pixels=inputs.max_pixels)
            )
    with Stages() as progress:
        surface = processing.integrate_in_blocks(
            vectors,
            mask,
            folder,
            rows=rows,
            camera=inputs.camera,
            pixel_mm=inputs.pixel_mm,
            depth_mm=inputs.depth_mm,
            sigma_deg=sigma if inputs.weighted else None,
            resume=True,
            on_progress=progress,
        )
    opened.callback(surface.close)
    bands = acquisition.rows_in_bands(way.size[0], 400 * way.size[1], _BAND)
    for part in shown("comparing with the normals", bands):
        store["residual"][part] = processing.residual_of_rows(surface, vectors, part)
    curl = processing.curl_in_rows(vectors, mask, store["curl"], inputs.camera, sigma)
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
    result.inputs = list(read.files)
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
