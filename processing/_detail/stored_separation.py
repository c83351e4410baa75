"""Separation of normal maps that are larger than memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import BandStore, MapRows
from processing._detail.rows import halo_rows, rows_of_band, separate_rows
from processing._detail.separation import sums_of_rows
from processing._detail.shape_filter import ShapeFilter
from processing._metrics import angle_map_deg
from processing._normal_decoding import Green
from processing._normal_map_files import find_normals, store_normals
from rig import MAX_PIXELS, Notice, Progress, no_progress

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StoredSeparation:
    """The shape and detail components of a normal map that is larger than memory.

    Parameters
    ----------
    normals, shape, detail
        ``(H, W, 3)`` float32 unit vectors, 0 outside the mask, whose rows are read on request.
    mask
        ``(H, W)`` bool, the pixels with a normal.
    shape_filter
        The filter that separated them.
    separability_deg
        As in `Separation`.
    warnings, files
        As in `NormalMapFile`.
    store
        The files of the maps, which `BandStore.remove` deletes.
    """

    normals: MapRows
    shape: MapRows
    detail: MapRows
    mask: Mask
    shape_filter: ShapeFilter
    separability_deg: float
    warnings: tuple[Notice, ...]
    files: tuple[Path, ...]
    store: BandStore

    def __repr__(self) -> str:
        height, width = self.mask.shape
        return f"StoredSeparation({width} x {height} px, {self.shape_filter!r})"


def separate_on_disk(
    path: str | Path,
    target: Path,
    *,
    memory: int,
    identity: Mapping[str, object],
    replace: bool = False,
    shape_filter: ShapeFilter = ShapeFilter(),
    green: Green = "up",
    max_pixels: int = MAX_PIXELS,
    on_progress: Progress = no_progress,
) -> StoredSeparation:
    """Read and separate a normal map in bands of rows, with the components in files.

    The values are those of `read_normals` and `separate`. Rows that are on the disk are not
    computed again if the process is killed and the function is called with the same identity.

    Parameters
    ----------
    path, green, max_pixels
        As for `read_normals`.
    target
        Future result. The maps are in a hidden folder next to it, see `BandStore`, until the
        caller removes them.
    memory
        Bytes to use, at least those of `least_memory_of_separation`.
    identity
        What the result depends on, see `BandStore`.
    replace
        Begin again if there are maps of another identity.
    shape_filter
        The low-pass filter.
    on_progress
        Receives the stage ``detail``, in rows.

    Raises
    ------
    DataError, MissingPathError
        As `read_normals`, `separate` and `BandStore`.
    StorageError
        If the disk refuses a write; rows that are complete stay.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap, separate_on_disk, write_normals
    >>> y, x = np.mgrid[1:-1:32j, -1:1:32j]
    >>> _ = write_normals("bowl", NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2])))
    >>> parts = separate_on_disk("bowl", Path("parts/detail"), memory=10**9, identity={})
    >>> parts.shape[10:12].shape
    (2, 32, 3)
    """
    size = find_normals(path, max_pixels=max_pixels).size
    shape_filter.check_size(size)
    vectors = ((*size, 3), np.float32)
    forms = {"normals": vectors, "shape": vectors, "detail": vectors}
    store = BandStore(target, identity, {**forms, "sums": (size[:1], np.float64)}, replace=replace)
    with store.filling():
        read = store_normals(path, store["normals"].path, green=green, max_pixels=max_pixels)
        read.normals.close()  # the store has the file, too
        count = rows_of_band(size, shape_filter, memory)
        _fill(store, read.mask, count, shape_filter, on_progress)
    return StoredSeparation(
        normals=store["normals"],
        shape=store["shape"],
        detail=store["detail"],
        mask=read.mask,
        shape_filter=shape_filter,
        separability_deg=float(store["sums"][:].sum() / np.count_nonzero(read.mask)),
        warnings=read.warnings,
        files=read.files,
        store=store,
    )


def _fill(
    store: BandStore, mask: Mask, count: int, shape_filter: ShapeFilter, on_progress: Progress
) -> None:
    """Compute the rows that are missing."""
    height, halo = len(mask), halo_rows(shape_filter)
    bands = store.missing_bands(count)
    on_progress("detail", bands[0].start if bands else height, height)
    for rows in bands:
        parts = separate_rows(store["normals"], mask, rows, shape_filter=shape_filter)
        store["shape"][rows], store["detail"][rows] = parts
        del parts
        # The rows of the detail that are known with all rows around them.
        last = height if rows.stop == height else max(rows.stop - halo, 0)
        judged = slice(max(rows.start - halo, 0), last)
        if judged.stop > judged.start:
            left, _ = separate_rows(store["detail"], mask, judged, shape_filter=shape_filter)
            angles = angle_map_deg(left, (0.0, 0.0, 1.0), mask[judged])
            store["sums"][judged] = sums_of_rows(angles, mask[judged])
        store.complete(rows)
        on_progress("detail", rows.stop, height)
