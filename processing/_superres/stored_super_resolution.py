"""Super-resolution of normal maps that are larger than memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import BandFile, BandStore, MapRows
from processing._normal_decoding import Green
from processing._normal_map_files import find_normals, store_normals
from processing._superres.enlargement import Enlargement, invented_share
from processing._superres.median import median_of_rows
from processing._superres.model import SuperResolutionModel
from processing._superres.super_resolution import PixelSampling, SuperResolutionMethod
from processing._superres.tiles import enlarged_rows
from rig import MAX_PIXELS, Notice, Progress, no_progress

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StoredSuperResolution:
    """A normal map of a higher resolution that is larger than memory.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors, 0 outside the mask, whose rows are read on request.
    mask
        ``(H, W)`` bool.
    sigma_deg, added_deg, invented
        ``(H, W)`` float32 as in `SuperResolution`, whose rows are read on request.
    invented_share, median_sigma_deg, mean_added_deg, method, scale, model, self_ensemble
        As in `SuperResolution`.
    low, low_mask
        ``(h, w, 3)`` and ``(h, w)``: the given map.
    warnings, files
        As in `NormalMapFile`.
    store
        The files of the maps, which `BandStore.remove` deletes.
    """

    normals: MapRows
    mask: Mask
    sigma_deg: MapRows | None
    added_deg: MapRows
    invented: MapRows
    invented_share: float
    median_sigma_deg: float
    mean_added_deg: float
    method: SuperResolutionMethod
    scale: int
    model: SuperResolutionModel | None
    self_ensemble: bool
    low: BandFile
    low_mask: Mask
    warnings: tuple[Notice, ...]
    files: tuple[Path, ...]
    store: BandStore

    def __repr__(self) -> str:
        height, width = self.mask.shape
        return f"StoredSuperResolution({width} x {height} px, {self.method}, x{self.scale})"


def super_resolve_on_disk(
    path: str | Path,
    target: Path,
    scale: int,
    *,
    identity: Mapping[str, object],
    replace: bool = False,
    method: SuperResolutionMethod | None = None,
    model: str | Path | SuperResolutionModel | None = None,
    self_ensemble: bool | None = None,
    sampling: PixelSampling = "area",
    green: Green = "up",
    max_pixels: int = MAX_PIXELS,
    most_enlarged: int = MAX_PIXELS,
    on_progress: Progress = no_progress,
) -> StoredSuperResolution:
    """Read and enlarge a normal map in bands of rows, with the result in files.

    The values are those of `read_normals` and `super_resolve`. Rows that are on the disk are not
    computed again if the process is killed and the function is called with the same identity. The
    memory is that of `least_memory_of_super_resolution`.

    Parameters
    ----------
    path, green, max_pixels
        As for `read_normals`.
    target
        Future result. The maps are in a hidden folder next to it, see `BandStore`, until the
        caller removes them.
    scale, method, model, self_ensemble, sampling
        As for `super_resolve`.
    identity
        What the result depends on, see `BandStore`.
    replace
        Begin again if there are maps of another identity.
    most_enlarged
        Largest number of pixels of the result.
    on_progress
        Receives the stage ``super-resolution``, in tiles.

    Raises
    ------
    DataError, MissingPathError
        As `read_normals`, `super_resolve` and `BandStore`.
    StorageError
        If the disk refuses a write; rows that are complete stay.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap, super_resolve_on_disk, write_normals
    >>> y, x = np.mgrid[1:-1:24j, -1:1:32j]
    >>> _ = write_normals("bowl", NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])))
    >>> super_resolve_on_disk("bowl", Path("large/map"), 4, identity={}, method="bicubic")
    StoredSuperResolution(128 x 96 px, bicubic, x4)
    """
    way = Enlargement.by(scale, method, model, self_ensemble, sampling)
    size = way.size(find_normals(path, max_pixels=max_pixels).size, most_enlarged)
    store = BandStore(target, identity, way.forms(size), replace=replace)
    with store.filling():
        read = store_normals(path, store.folder / "low.raw", green=green, max_pixels=max_pixels)
        store.close_with(read.normals)
        _fill(store, way, read.normals, read.mask, on_progress)
        mask, sums = store["mask"][:], store["sums"][:]
        sigma = store.get("sigma_deg")
        median = float("nan") if sigma is None else median_of_rows(sigma, mask)
    return StoredSuperResolution(
        normals=store["normals"],
        mask=mask,
        sigma_deg=sigma,
        added_deg=store["added_deg"],
        invented=store["invented"],
        invented_share=invented_share(sums),
        median_sigma_deg=median,
        mean_added_deg=float(sums[:, 2].sum() / np.count_nonzero(mask)),
        method=way.method,
        scale=scale,
        model=way.model,
        self_ensemble=way.self_ensemble,
        low=read.normals,
        low_mask=read.mask,
        warnings=read.warnings,
        files=read.files,
        store=store,
    )


def _fill(
    store: BandStore, way: Enlargement, low: MapRows, mask: Mask, on_progress: Progress
) -> None:
    """Compute the bands that are missing."""
    bands = way.bands(mask)
    complete = {rows.start for rows in store.done}
    missing = [band for band in bands if band.core.start * way.scale not in complete]
    count = way.tile_count(mask, bands)
    done = count - way.tile_count(mask, missing)

    def on_tile() -> None:
        nonlocal done
        done += 1
        on_progress("super-resolution", done, count)

    on_progress("super-resolution", done, count)
    for band in missing:
        rows = enlarged_rows(band.core, way.scale)
        for name, values in way.rows(low, mask, band, on_tile=on_tile).items():
            store[name][rows] = values
        store.complete(rows)
