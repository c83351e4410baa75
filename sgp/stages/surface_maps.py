"""Integrate normals to a surface, as a whole or in blocks of rows, and write it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

import acquisition
import calibration
import processing
import rig
from rig.arrays import Bool, Float32, UInt8
from sgp.cli.console import Stages
from sgp.cli.exit import UsageError
from sgp.results import Result, claim_folder, input_hashes, sha256
from sgp.stages.memory_limit import identity, is_in_bands, other_maps_refused, size_text
from sgp.stages.options import SurfaceOptions
from sgp.stages.sigma_map import read_sigma
from sgp.stages.write_surface import write_surface

# Bytes per pixel of temporary and final files in blocks.
_TEMPORARY, _FILES = 64, 75
_CAMERA_FILES, _SIGMA_FILES, _STL_FILE = 12, 4, 100
# Values that are read at once.
_READ = 4_000_000


@dataclass(frozen=True)
class SurfaceWay:
    """How a surface is solved.

    Parameters
    ----------
    size
        Height and width of the map.
    rows
        Most rows of a block; None to solve it as a whole.
    memory
        Bytes of memory that it needs.
    disk
        Bytes of disk for files, temporary ones included; 0 as a whole, when they are not stated.
    """

    size: tuple[int, int]
    rows: int | None
    memory: int
    disk: int = 0

    @classmethod
    def within(
        cls,
        memory: int | None,
        size: tuple[int, int],
        stage: processing.surface.SurfaceStage,
        *,
        stl: bool,
        whole_for: list[str],
    ) -> SurfaceWay:
        """Return how a surface is solved within a memory.

        Parameters
        ----------
        memory
            Bytes to use; None for half of what is free.
        size
            Height and width of the map.
        stage
            What is known.
        stl
            Whether this file is written.
        whole_for
            Options that need the complete surface in memory. Without a stated memory, they are
            tried in any case.

        Raises
        ------
        UsageError
            If the memory is too small.
        """
        need = stage.need(size)
        if whole_for and memory is not None and memory < need.whole:
            raise UsageError(
                f"--memory {size_text(memory)} is too small for {need.of} with {whole_for[0]}, "
                f"which needs the complete surface: give --memory {size_text(need.whole)}, or "
                f"leave {whole_for[0]} out"
            )
        if whole_for or not is_in_bands(memory, need) or need.least == need.whole:
            return cls(size, None, need.whole)
        rows, used = stage.blocks(size, max(rig.processes.memory_budget(memory), need.least))
        per_pixel = _TEMPORARY + _FILES + stl * _STL_FILE
        per_pixel += stage.perspective * _CAMERA_FILES + stage.weighted * _SIGMA_FILES
        return cls(size, rows, used, size[0] * size[1] * per_pixel)

    def line(self) -> str:
        """Return what it needs, as a line for people."""
        height, width = self.size
        pixels = f"surface of {width} x {height} pixels"
        if self.rows is None:
            return f"{pixels}: as a whole, needs about {size_text(self.memory)} of memory"
        return (
            f"{pixels}: in blocks of {self.rows} rows, needs about {size_text(self.memory)} of "
            f"memory and {size_text(self.disk)} of disk"
        )


@dataclass(frozen=True, kw_only=True)
class SurfaceInputs:
    """What a surface is computed from.

    Parameters
    ----------
    normals, mask, albedo, sigma, green, max_pixels
        As `sgp surface` takes them. A run in memory gives normals, sRGB samples and standard
        deviations instead of files.
    prior
        File of known heights, and their standard deviation; None for the size of a pixel.
    camera
        The perspective camera; None for an orthographic surface.
    doubts
        Notices about the camera.
    depth_mm
        ``(H, W)`` approximate depth, as for `processing.integrate`.
    pixel_mm
        Size of a pixel on the object.
    weighted
        Whether normals count by ``sigma``, which otherwise only serves to judge their curl and the
        errors of the heights.
    common_sigma_deg
        The part of ``sigma`` that all pixels have in common, if they do not count by it.
    """

    normals: Path | processing.NormalMap
    mask: Path | None = None
    albedo: Path | UInt8 | None = None
    camera: acquisition.CameraModel | None = None
    doubts: tuple[rig.Notice, ...] = ()
    sigma: Path | acquisition.MapRows | None = None
    prior: tuple[Path, float | None] | None = None
    depth_mm: acquisition.MapRows | None = None
    pixel_mm: float | None = None
    weighted: bool = True
    common_sigma_deg: acquisition.MapRows | None = None
    green: Literal["up", "down"] = "up"
    max_pixels: int


def integrated(
    inputs: SurfaceInputs, options: SurfaceOptions, way: SurfaceWay, out: Path, *, force: bool
) -> tuple[Result, processing.HeightMap]:
    """Solve a surface and write its files; return the result, and the surface.

    In blocks, temporary files are in the output folder. The blocks that an earlier process solved
    from the same inputs are not solved again.

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
        If there are blocks of other inputs, or some were changed.
    """
    with ExitStack() as opened:
        store = None
        if way.rows is not None:
            store = opened.enter_context(_store(inputs, way, out, force=force))

        def image(path: Path | acquisition.MapRows) -> acquisition.MapRows:
            if not isinstance(path, Path):
                return path
            if store is None:
                return acquisition.read_image(path, max_pixels=inputs.max_pixels)
            return opened.enter_context(
                acquisition.pixels.ImageRows(path, max_pixels=inputs.max_pixels)
            )

        read, normals = _read(inputs, store)
        notices = [*read.warnings]
        if inputs.mask is not None:
            inside, lost = _masked(inputs.mask, normals.mask, str(inputs.normals))
            notices += lost
            normals = _only(normals, inside)
        notices += inputs.doubts
        sigma: acquisition.MapRows | None = None
        common: Float32 | float | None = None
        if inputs.common_sigma_deg is not None:
            common = inputs.common_sigma_deg[:]
        if isinstance(inputs.sigma, Path) and inputs.weighted:
            known = read_sigma(inputs.sigma, normals.mask, inputs.max_pixels, store)
            notices += known.notices
            sigma, common = known.sigma_deg, known.common_deg
        elif inputs.sigma is not None:
            sigma = image(inputs.sigma)
        prior = None if inputs.prior is None else _prior(inputs, way.size, *inputs.prior)
        with Stages() as progress:
            if store is not None and way.rows is not None:
                surface = processing.surface.integrate_in_blocks(
                    normals,
                    store,
                    rows=way.rows,
                    camera=inputs.camera,
                    pixel_mm=inputs.pixel_mm,
                    depth_mm=inputs.depth_mm,
                    sigma_deg=sigma if inputs.weighted else None,
                    discontinuity=options.jumps(),
                    k=options.sharpness(),
                    replace=force,
                    on_progress=progress,
                )
            else:
                surface = processing.integrate(
                    cast("processing.NormalMap", normals),
                    camera=inputs.camera,
                    pixel_mm=inputs.pixel_mm,
                    depth_mm=None if inputs.depth_mm is None else inputs.depth_mm[:],
                    sigma_deg=None if sigma is None else sigma[:],
                    common_sigma_deg=common,
                    weighted=inputs.weighted,
                    prior=prior,
                    height_errors=options.height_sigma and sigma is not None,
                    discontinuity=options.jumps(),
                    k=options.sharpness(),
                    on_progress=progress,
                )
        colours = None
        if inputs.albedo is not None:
            colours = _colours(inputs.albedo, image(inputs.albedo), normals.mask)
        # Results of an earlier command are removed only now.
        result = write_surface(
            claim_folder(out, "surface.json"),
            surface,
            normals,
            options,
            colours=colours,
            sigma_deg=sigma,
            maps=store,
        )
        if store is None:
            acquisition.files.remove_unfinished(out / "surface")
        result.warnings = [*notices, *result.warnings]
        result.inputs = [*read.files]
        if prior is not None:
            _add_prior(result, surface, prior)
        return result, surface


def _prior(
    inputs: SurfaceInputs, size: tuple[int, int], path: Path, sigma: float | None
) -> processing.HeightPrior:
    unit, pixel_size = processing.surface.surface_scale(inputs.camera, inputs.pixel_mm)
    known = pixel_size if sigma is None else sigma
    return processing.surface.read_prior(
        path, size, unit=unit, sigma=known, max_pixels=inputs.max_pixels
    )


@contextmanager
def _store(
    inputs: SurfaceInputs, way: SurfaceWay, out: Path, *, force: bool
) -> Iterator[acquisition.files.BandStore]:
    """Provide the maps of a surface in blocks, which are removed if the block ends well."""
    depends_on, path = _identity(inputs), out / "surface"
    with other_maps_refused():
        if not force:
            acquisition.files.check_unfinished(path, depends_on)
        place = next(folder for folder in (out, *out.absolute().parents) if folder.exists())
        free = shutil.disk_usage(place).free
        if free < way.disk and not acquisition.files.is_unfinished(path):
            raise acquisition.StorageError(
                f"{out}: the surface needs about {size_text(way.disk)} of disk while it is "
                f"computed, {size_text(free)} are free: free space, or choose another disk"
            )
        stage = processing.surface.SurfaceStage(inputs.camera is not None)
        forms = stage.forms(way.size)
        with acquisition.files.BandStore(path, depends_on, forms, replace=force) as store:
            try:
                yield store
            except acquisition.files.DamagedMapsError:
                raise
            except (acquisition.DataError, calibration.EstimateError, UsageError):
                # These inputs have no surface: there is nothing to continue.
                store.remove()
                with suppress(OSError):
                    out.rmdir()
                raise
            store.remove()


def _identity(inputs: SurfaceInputs) -> dict[str, object]:
    """Return what the solutions of blocks depend on."""
    normals = cast("Path", inputs.normals)
    found = processing.find_normals(normals, max_pixels=inputs.max_pixels)
    weights = cast("Path | None", inputs.sigma if inputs.weighted else None)
    given = {
        "green": inputs.green,
        "camera": None if inputs.camera is None else asdict(inputs.camera),
        "mask": None if inputs.mask is None else sha256(inputs.mask),
        "sigma": None if weights is None else sha256(weights),
    }
    return identity(given, list(found.files))


def _read(
    inputs: SurfaceInputs, store: acquisition.files.BandStore | None
) -> tuple[
    processing.NormalMapFile | processing.maps.StoredNormals,
    processing.NormalMap | processing.maps.StoredNormals,
]:
    """Read the normals into memory, or into a file next to the maps."""
    given, most = inputs.normals, inputs.max_pixels
    if isinstance(given, processing.NormalMap):
        return processing.NormalMapFile(given, (), ()), given
    if store is None:
        whole = processing.read_normals(given, green=inputs.green, max_pixels=most)
        input_hashes(whole.files)
        return whole, whole.normal_map
    with Stages() as progress:
        progress("reading normals", 0, 1)
        file = store.folder / "normals.raw"
        stored = processing.maps.store_normals(given, file, green=inputs.green, max_pixels=most)
        progress("reading normals", 1, 1)
    store.close_with(stored.normals)
    return stored, stored


def _masked(path: Path, known: Bool, normals: str) -> tuple[Bool, list[rig.Notice]]:
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


def _only(
    given: processing.NormalMap | processing.maps.StoredNormals, inside: Bool
) -> processing.NormalMap | processing.maps.StoredNormals:
    """Return the normals inside a mask; a file is changed."""
    if isinstance(given, processing.NormalMap):
        return processing.NormalMap(given.normals * inside[..., None], inside)
    height, width = inside.shape
    for rows in acquisition.files.rows_in_bands(height, width, _READ):
        given.normals[rows] = given.normals[rows] * inside[rows][..., None]
    return given._replace(mask=inside)


def _colours(path: object, image: acquisition.MapRows, mask: Bool) -> acquisition.MapRows:
    """Return sRGB samples, in memory as the image: floats are linear albedo, others are sRGB."""
    kind, (height, width) = np.dtype(np.uint8), mask.shape
    if image.shape[:2] != mask.shape:
        raise acquisition.DataError(
            f"{path}: {image.shape[1]} x {image.shape[0]} pixels, but the normals have "
            f"{width} x {height}: give an image of the same size"
        )
    if image.dtype == kind:
        return image
    if image.dtype == np.uint16:
        samples = acquisition.files.ComputedRows(
            image.shape, kind, lambda rows: np.rint(image[rows] / 257).astype(kind)
        )
    else:
        white = processing.colour.albedo_white(image, mask)
        samples = acquisition.files.ComputedRows(
            image.shape,
            kind,
            lambda rows: processing.colour.albedo_samples(image[rows], mask[rows], white),
        )
    if not isinstance(image, np.ndarray):
        return samples
    painted = np.zeros(image.shape, kind)
    for rows in acquisition.files.rows_in_bands(height, width, _READ):
        painted[rows] = samples[rows]
    return painted


def _add_prior(
    result: Result, height_map: processing.HeightMap, prior: processing.HeightPrior
) -> None:
    """Add the number of known heights on the surface, and how far it is from them."""
    inside = height_map.mask & prior.known
    off, sigma = (height_map.height - prior.height)[inside], prior.sigma[inside]
    rms, stated = (float(np.sqrt(np.mean(one.astype(np.float64) ** 2))) for one in (off, sigma))
    figures = {"prior_heights": len(off), "prior_rms": rms, "prior_sigma": stated}
    result.metrics = {**result.metrics, **figures}
    heights = rig.pluralize(len(off), "known height")
    result.summary.append(f"{rig.figure(rms)} {height_map.unit} rms from {heights}")
