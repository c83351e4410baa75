"""Reconstruction of recordings whose maps are larger than memory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import (
    BandStore,
    MapRows,
    Source,
    check_unfinished,
    rows_in_bands,
    setup_notices,
)
from calibration import BandedStack, open_stack
from processing._metrics import AngularError, angular_error
from processing._normal_map import NormalMap
from processing._reconstruction.banded_normals import map_forms, solve_bands
from processing._reconstruction.colour_albedo import ColourSums, coloured, may_have_colour
from processing._reconstruction.error_bars import (
    ErrorBarMaps,
    check_any_valid,
    validity_notices,
)
from processing._reconstruction.examination import Examination
from processing._reconstruction.examined import check_facing, examination_of, geometry_of
from processing._reconstruction.memory import rows_of_band
from processing._reconstruction.stored_reconstruction import StoredReconstruction, finished_maps
from processing._stereo.method import Method
from processing._stereo.photometric_stereo import check_solved
from processing._uncertainty.sample_kind import Reason
from rig import Notice, Progress, check_type, no_progress

Mask = npt.NDArray[np.bool_]

# Bytes of rows that are read together after the bands.
_READ = 32_000_000


def reconstruct_on_disk(
    source: Source,
    path: Path,
    *,
    memory: int,
    identity: Mapping[str, object],
    replace: bool = False,
    method: Method = "best",
    distant: bool = False,
    height_mm: float | None = None,
    rests_on_plane: bool = False,
    pixel_mm: float | None = None,
    exclude_disagreeing: bool = False,
    on_progress: Progress = no_progress,
) -> StoredReconstruction:
    """Compute the normals of a recording in bands of rows, with the maps in files.

    The values are those of `reconstruct`. A band whose rows are on the disk is not computed again
    if the process is killed and the function is called with the same identity.

    Parameters
    ----------
    source, method, distant, height_mm, rests_on_plane, pixel_mm, exclude_disagreeing, on_progress
        As in `reconstruct`; the channel is gray, and the albedo has the colours of the images.
    path
        Future result. The maps are in a hidden folder next to it, see `BandStore`, until the
        caller removes them.
    memory
        Bytes to use, at least those of `least_memory`.
    identity
        What the result depends on besides the source, see `BandStore`.
    replace
        Begin again if there are maps of another identity.

    Raises
    ------
    DataError, EstimateError
        As `reconstruct` and `BandStore`.
    StorageError
        If the disk refuses a write; rows that are complete stay.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from acquisition import Lights, read_source, write_png
    >>> from processing import reconstruct_on_disk
    >>> lights = Lights(directions=[[1, 0, 2], [0, 1, 2], [-1, 0, 2], [0, -1, 2]])
    >>> for i in range(4):
    ...     write_png(f"card.{i}.png", np.pad(np.full((40, 60), 9000, np.uint16), 9))
    >>> source = read_source(".", lights=lights)
    >>> reconstruct_on_disk(source, Path("a"), memory=10**9, identity={})
    StoredReconstruction(., 78 x 58 px)
    """
    check_type("source", source, Source, "acquisition.read_source(path) returns one")
    geometry = geometry_of(
        source, pixel_mm, height_mm, rests_on_plane=rests_on_plane, distant=distant
    )
    if not replace:
        check_unfinished(path, identity)
    with open_stack(source, on_progress=on_progress) as stack:
        examined, of_mask = examination_of(source, stack, geometry, method, on_progress)
        examined.leave_out_unlit()
        examined.find_surface(semi_calibrated=False)
        quality = examined.check(exclude_disagreeing=exclude_disagreeing)
        mask, count = examined.mask, len(examined.lights)
        colours = _colours(source, stack, examined)
        forms = map_forms(mask.shape, count)
        forms["first"] = forms["last"] = (mask.shape, np.float32)
        if colours is not None:
            forms["colour"] = ((*mask.shape, 3), np.float32)
        store = BandStore(path, identity, forms, replace=replace)
        try:

            def on_band(rows: slice) -> None:
                if colours is not None:
                    store["colour"][rows] = _albedo_in_colour(store, colours, examined, rows)
                store.complete(rows)

            shown = solve_bands(
                examined,
                method,
                on_progress,
                store,
                store.missing(),
                rows_of_band(source, count, memory, colour=colours is not None),
                on_band,
            )
            valid, notices = _valid_pixels(store, examined)
            warnings = (
                *source.warnings,
                *setup_notices(source),
                *examined.images.warnings,
                *of_mask,
                *examined.warnings,
                *notices,
                *validity_notices(store["reason"][:], mask, shown.origin, shown.correlation),
            )
            common = ErrorBarMaps(store).common_variance()
            maps = finished_maps(store, valid, common, shown.origin)
            _check_facing(source, maps["normals"], valid)
        except BaseException:
            store.close()
            raise
    return StoredReconstruction(
        source=examined.source,
        lights=examined.lights,
        mask=mask,
        valid=valid,
        maps=maps,
        noise=shown.origin,
        neighbour_correlation=shown.correlation,
        quality=quality,
        excluded=examined.excluded,
        error=_error(source, maps["normals"], valid, mask),
        previews=(store["first"], store["last"]),
        near_height=examined.near,
        warnings=warnings,
        store=store,
    )


def _colours(source: Source, stack: BandedStack, examined: Examination) -> BandedStack | None:
    """Return the images in colour; None if they have none."""
    if not may_have_colour(source):
        return None
    colours = stack.in_channel("rgb")
    first = stack.ids.index(examined.images.ids[0])
    height, width = source.size
    bands = rows_in_bands(height, 12 * width, _READ)
    return colours if any(coloured(colours.image(first, rows)) for rows in bands) else None


def _albedo_in_colour(
    store: BandStore, colours: BandedStack, examined: Examination, rows: slice
) -> npt.NDArray[np.float32]:
    """Return rows of the albedo in colour, from the rows of the other maps."""
    normals, albedo, residual = (store[name][rows] for name in ("normals", "albedo", "residual"))
    valid = (albedo > 0) & (store["reason"][rows] == Reason.VALID)
    points = None if examined.points is None else examined.points.of(rows)
    sums = ColourSums(NormalMap.of_unit_vectors(normals, valid), albedo, residual, points)
    ids, lights = examined.images.ids, examined.lights
    for i, name in enumerate(ids):
        sums.add(colours.image(colours.ids.index(name), rows), lights.take([i]), len(ids))
    return sums.albedo()


def _valid_pixels(store: BandStore, examined: Examination) -> tuple[Mask, list[Notice]]:
    """Return the pixels that have a normal, and notices about others."""
    mask = examined.mask
    solved, reason = np.zeros(mask.shape, np.bool_), store["reason"][:]
    most_used = 0
    for rows in _bands(mask, 6):
        solved[rows] = store["albedo"][rows] > 0
        used = store["used"][rows][mask[rows]]
        most_used = max(most_used, int(used.max(initial=0)))
    notices = check_solved(solved, mask, most_used, examined.images)
    valid = solved & (reason == Reason.VALID)
    check_any_valid(valid, reason, solved)
    return valid, list(notices)


def _check_facing(source: Source, normals: MapRows, valid: Mask) -> None:
    total = sum(float(normals[rows][..., 2].sum(dtype=np.float64)) for rows in _bands(valid, 12))
    check_facing(source, total)


def _error(source: Source, normals: MapRows, valid: Mask, mask: Mask) -> AngularError | None:
    # True normals are in memory, so these can be, too.
    if source.normals_truth is None:
        return None
    return angular_error(NormalMap(normals[:], valid), source.normals_truth, mask)


def _bands(mask: Mask, pixel_bytes: int) -> list[slice]:
    height, width = mask.shape
    return rows_in_bands(height, pixel_bytes * width, _READ)
