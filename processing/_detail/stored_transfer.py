"""Transfer of detail between normal maps that are larger than memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquisition import BandStore, MapRows
from processing._detail.placement import Placement
from processing._detail.shape_filter import ShapeFilter
from processing._detail.tile import Tile
from processing._detail.transfer_figures import TransferFigures
from processing._detail.transfer_memory import TransferSizes
from processing._detail.transfer_rows import check_amplitude, check_steps
from processing._detail.transfer_stages import TransferStages
from processing._normal_decoding import Green
from processing._normal_map_files import StoredNormals, find_normals, store_normals
from rig import MAX_PIXELS, Progress, no_progress


@dataclass(frozen=True, eq=False)
class StoredTransfer:
    """The result of a transfer between normal maps that are larger than memory.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors, 0 outside the mask of the target, whose rows are read on
        request.
    shape_error_deg, detail_error_deg
        ``(H, W)`` float32 as in `TransferFidelity`, NaN where no detail was received.
    figures
        Mean errors, similarities and steps.
    placement
        Position of the source on the target.
    source, target
        The maps.
    store
        The files of the maps, which `BandStore.remove` deletes.
    """

    normals: MapRows
    shape_error_deg: MapRows
    detail_error_deg: MapRows
    figures: TransferFigures
    placement: Placement
    source: StoredNormals
    target: StoredNormals
    store: BandStore

    def __repr__(self) -> str:
        height, width = self.target.mask.shape
        return f"StoredTransfer({width} x {height} px, {self.placement!r})"


def transfer_on_disk(
    source: str | Path,
    target: str | Path,
    path: Path,
    *,
    memory: int,
    identity: Mapping[str, object],
    replace: bool = False,
    keep_target_detail: bool = False,
    amplitude: float = 1.0,
    refine: int = 0,
    shape_filter: ShapeFilter = ShapeFilter(),
    at: tuple[int, int] | None = None,
    tile: Tile = "cut",
    source_green: Green = "up",
    target_green: Green = "up",
    max_pixels: int = MAX_PIXELS,
    on_progress: Progress = no_progress,
) -> StoredTransfer:
    """Read two normal maps and transfer detail in bands of rows, with the result in files.

    The values are those of `read_normals` and `transfer`. Rows that are on the disk are not
    computed again if the process is killed and the function is called with the same identity.

    Parameters
    ----------
    source, target, source_green, target_green, max_pixels
        The maps, as for `read_normals`.
    path
        Future result. The maps are in a hidden folder next to it, see `BandStore`, until the
        caller removes them.
    memory
        Bytes to use, at least those of `least_memory_of_transfer`.
    identity
        What the result depends on, see `BandStore`.
    replace
        Begin again if there are maps of another identity.
    keep_target_detail, amplitude, refine, shape_filter, at, tile
        As for `transfer`.
    on_progress
        Receives the stage ``transferring``, in rows of all steps.

    Raises
    ------
    DataError, MissingPathError
        As `read_normals`, `transfer` and `BandStore`; if the rectangle of the source that is
        repeated does not fit into the memory, which the cuts between its copies need.
    StorageError
        If the disk refuses a write; rows that are complete stay.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap, transfer_on_disk, write_normals
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> _ = write_normals("bowl", NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])))
    >>> made = transfer_on_disk("bowl", "bowl", Path("out/map"), memory=10**9, identity={})
    >>> made.normals[10:12].shape, made.figures.pixels
    ((2, 32, 3), 1024)
    """
    check_steps(refine)
    check_amplitude(amplitude)
    found = [find_normals(part, max_pixels=max_pixels) for part in (source, target)]
    for part in found:
        shape_filter.check_size(part.size)
    sizes = TransferSizes(found[0].size, found[1].size, shape_filter, refine)
    tiled = tile if at is None else None
    stages = TransferStages(sizes, tiled, amplitude, keep_target_detail=keep_target_detail)
    store = BandStore(path, identity, stages.forms, replace=replace, units=stages.units)
    with store.filling():
        first, second = (
            store_normals(file, store[name].path, green=green, max_pixels=max_pixels)
            for file, name, green in (
                (source, "source", source_green),
                (target, "target", target_green),
            )
        )
        for read in (first, second):
            read.normals.close()  # the store has the file, too
        masks = first.mask, second.mask
        placement = stages.placement(store, masks, at, memory)
        stages.fill(store, masks, placement, memory, on_progress)
        figures = stages.figures(store, second.mask)
    return StoredTransfer(
        normals=store[stages.result],
        shape_error_deg=store["shape_error"],
        detail_error_deg=store["detail_error"],
        figures=figures,
        placement=placement,
        source=first._replace(normals=store["source"]),
        target=second._replace(normals=store["target"]),
        store=store,
    )
