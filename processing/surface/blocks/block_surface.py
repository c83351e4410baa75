"""Integration of a normal map in blocks of rows."""

from __future__ import annotations

import functools
import math

import numpy as np

from acquisition import CameraModel, DataError, MapRows
from acquisition.files import BandStore, DamagedMapsError, Maps
from processing.stages.stage import NormalRows
from processing.surface.blocks.block_files import remove_steps
from processing.surface.blocks.solution import BlockSolution, solve_in_blocks
from processing.surface.consistency import StepAngles, consistency_warning
from processing.surface.edge_certainty import variances
from processing.surface.height_map import BlockFigures, HeightMap
from processing.surface.integrability_test import integrability
from processing.surface.jumps import SHARPNESS
from processing.surface.scale import Scale, check_depth_range, check_view, nothing_faces, scale_of
from processing.surface.surface_notices import doubts_of_jumps, doubts_of_solution, parts_notices
from rig import Notice, Progress, no_progress
from rig.arrays import Bool, Float64, Int32

# The median of deviations is that of some rows with about this number of pixels.
_SAMPLE = 4_000_000


def integrate_in_blocks(
    normal_map: NormalRows,
    store: BandStore,
    *,
    rows: int,
    camera: CameraModel | None = None,
    pixel_mm: float | None = None,
    depth_mm: MapRows | None = None,
    sigma_deg: MapRows | None = None,
    discontinuity: bool | None = None,
    k: float = SHARPNESS,
    replace: bool = False,
    on_progress: Progress = no_progress,
) -> HeightMap:
    """Integrate a normal map that is larger than memory.

    The result is that of `integrate` up to a small error, which is estimated. Blocks of rows are
    solved one after the other; the solutions of neighbours are then corrected in rounds by a coarse
    Poisson problem over the complete map and by the changes at the outermost rows of each block
    (restricted additive Schwarz with a coarse space: Cai and Sarkis, 1999; combined as by Anderson,
    1965), until the estimated error is below a few parts in 10,000 of the range.

    Parameters
    ----------
    normal_map
        The normals, perhaps in a file.
    store
        The maps of `SurfaceStage`, which are filled. The result of each step is in files next to
        them, up to 28 bytes per pixel: a later process continues after the last step, with its
        blocks if they have no more than ``rows``.
    rows
        Most rows of a block; `SurfaceStage.blocks` states what they need.
    camera, pixel_mm
        As for `integrate`.
    depth_mm
        ``(H, W)`` approximate depth, as for `integrate`.
    sigma_deg
        ``(H, W)`` float32 standard deviations of the normals, as for `integrate`.
    discontinuity, k
        As for `integrate`. Pieces between jumps are searched in the complete map in pixels of
        2 x 2 to 8 x 8 pixels, and jumps in the blocks from there.
    replace
        Begin again if a step was changed, which is otherwise refused.
    on_progress
        Receives the stages ``integrating``, ``joining blocks`` and ``placing``, in blocks.

    Returns
    -------
    HeightMap
        The surface, with the maps of the store.

    Raises
    ------
    DamagedMapsError
        If a step was changed or deleted since it was computed.
    DataError, EstimateError
        As `integrate`.
    StorageError
        If the disk refuses a file.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from acquisition.files import BandStore
    >>> from processing import NormalMap
    >>> from processing.surface import SurfaceStage, integrate_in_blocks
    >>> y, x = np.mgrid[1:-1:96j, -1:1:40j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> with BandStore(Path("bowl"), {}, SurfaceStage().forms(bowl.size)) as store:
    ...     surface = integrate_in_blocks(bowl, store, rows=32)
    ...     surface.blocks.number, surface.maps["height"][0:2].shape
    (3, (2, 40))
    """
    normals, mask = normal_map.normals, normal_map.mask
    scale = scale_of(camera, pixel_mm)
    if not mask.any():
        raise DataError("a normal map with an empty mask holds no normal: check the mask")
    check_view(mask, camera, pixel_mm, depth_mm)
    relative, _ = variances(sigma_deg, mask, most=_SAMPLE)
    shape = integrability(normals, mask)
    if discontinuity is None and shape.axes != "right":
        discontinuity = False
    problem = normals, relative, camera, store, rows, discontinuity, k, on_progress
    try:
        solved = solve_in_blocks(*problem)
    except DamagedMapsError:
        if not replace:
            raise
        remove_steps(store.folder)
        solved = solve_in_blocks(*problem)
    pixels = int(solved.sizes.sum())
    if not pixels:
        raise nothing_faces()
    step = scale.step_px if camera is None else -scale.step_px
    angles = StepAngles.between(step * solved.wanted, step * solved.found)
    inside, (lowest, highest) = _placed(solved, scale, depth_mm, store, on_progress)
    error = solved.rounds.error * (scale.distance or scale.pixel_size)
    notices = [
        *parts_notices(len(solved.means), int(np.count_nonzero(mask)) - pixels),
        *([] if solved.jumps is None else doubts_of_jumps(solved.jumps, solved.parts)),
        *doubts_of_solution(solved.worst),
        *consistency_warning(angles, shape, smooth=solved.jumps is None),
    ]
    if not solved.rounds.settled:
        share = error / (highest - lowest) if highest > lowest else 0.0
        text = (
            f"after {solved.rounds.number} rounds, the surface differs from that of the whole by "
            f"about {share:.2%} of its range: use more memory"
        )
        notices.append(Notice("blocks-not-settled", text))
    return HeightMap(
        maps={name: store[name] for name in ("height", "parts", "depth") if name in store},
        mask=inside,
        unit=scale.unit,
        pixel_size=scale.pixel_size,
        camera=camera,
        iterations=solved.worst.iterations,
        relative_residual=solved.worst.relative_residual,
        warnings=tuple(notices),
        disagreement_deg=angles.median_deg,
        curl=shape.curl,
        jumps=solved.jumps,
        blocks=BlockFigures(len(solved.blocks.blocks), solved.rounds.number, error),
    )


def _placed(
    solved: BlockSolution,
    scale: Scale,
    near: MapRows | None,
    maps: Maps,
    on_progress: Progress,
) -> tuple[Bool, tuple[float, float]]:
    """Write heights and depths in their unit; return their pixels and their range."""
    raised, factors = np.zeros(len(solved.means)), np.ones(len(solved.means))
    near_means = None
    if near is not None:
        near_means = solved.part_means(lambda rows, inside, _: near[rows][inside])
    if scale.distance is not None:
        wanted = scale.distance if near_means is None else near_means
        factors = wanted / solved.part_means(functools.partial(_depths, solved))
    elif near_means is not None:
        raised = -near_means
    blocks = solved.blocks.blocks
    known = np.zeros(solved.u.shape, np.bool_)
    lowest, highest = math.inf, -math.inf
    on_progress("placing", 0, len(blocks))
    for number, block in enumerate(blocks):
        rows = block.core
        labels = solved.parts[rows]
        known[rows] = inside = labels >= 0
        members = labels[inside]
        u = solved.centred(rows, inside, members)
        values = np.full(labels.shape, np.nan, np.float32)
        if scale.distance is None:
            found = scale.pixel_size * u + raised[members]
        else:
            values[inside] = depths = np.exp(u) * factors[members]
            maps["depth"][rows] = values
            found = scale.distance - depths
        values[inside] = found
        maps["height"][rows] = values
        if len(found):
            lowest = min(lowest, float(values[inside].min()))
            highest = max(highest, float(values[inside].max()))
        on_progress("placing", number + 1, len(blocks))
    return known, (lowest, highest)


def _depths(solved: BlockSolution, rows: slice, inside: Bool, members: Int32) -> Float64:
    """Return depths for a logarithm of the depth with mean 0, see `BlockSolution.part_means`."""
    u = solved.centred(rows, inside, members)
    check_depth_range(u)
    return np.asarray(np.exp(u), np.float64)
