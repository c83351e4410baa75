"""Integration of a normal map in blocks of rows."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from acquisition import BandFile, CameraModel, DataError, MapRows, rows_in_bands
from calibration import EstimateError
from processing._blocks.block_files import BlockFiles
from processing._blocks.plan import Blocks
from processing._blocks.relative_variances import relative_variances
from processing._blocks.solution import BlockSolution, solve_in_blocks
from processing._surface.consistency import angle_between_deg, consistency_warning
from processing._surface.integrability import integrability
from processing._surface.scale import DEPTH_RANGE, Scale, scale_of
from processing._surface.surface_notices import doubts_of_solution, parts_notices
from rig import Notice, Progress, no_progress, short_repr

Mask = npt.NDArray[np.bool_]
Double = npt.NDArray[np.float64]

# Values that are read at once.
_READ = 4_000_000


@dataclass(frozen=True, eq=False)
class BlockSurface:
    """A surface over the pixels of an image, whose maps are in files.

    Parameters
    ----------
    height
        ``(H, W)`` float32 as in `HeightMap`.
    depth
        ``(H, W)`` float32 as in `HeightMap`; None for an orthographic surface.
    mask
        ``(H, W)`` bool as in `HeightMap`.
    parts
        ``(H, W)`` int32 as in `HeightMap`.
    unit, pixel_size, camera
        As in `HeightMap`.
    pixels, part_count
        Number of pixels with a height, and of connected parts.
    lowest, highest
        Range of the heights.
    iterations, relative_residual
        Of the linear solver, in the block with the largest residual.
    blocks
        Number of blocks.
    rounds
        Number of rounds in which blocks were corrected by their neighbours.
    error
        Estimated largest difference from the surface that is integrated as a whole, in ``unit``.
    disagreement_deg, curl, warnings
        As in `HeightMap`.
    """

    height: BandFile
    depth: BandFile | None
    mask: Mask
    parts: BandFile
    unit: Literal["mm", "px"]
    pixel_size: float
    camera: CameraModel | None
    pixels: int
    part_count: int
    lowest: float
    highest: float
    iterations: int
    relative_residual: float
    blocks: int
    rounds: int
    error: float
    disagreement_deg: float
    curl: float
    warnings: tuple[Notice, ...]

    __repr__ = short_repr

    @property
    def jumps(self) -> None:
        """Jumps in depth are not looked for."""

    def close(self) -> None:
        """Close the files; harmless if repeated."""
        for file in (self.height, self.depth, self.parts):
            if file is not None:
                file.close()


def integrate_in_blocks(
    normals: MapRows,
    mask: Mask,
    folder: Path,
    *,
    rows: int,
    camera: CameraModel | None = None,
    pixel_mm: float | None = None,
    depth_mm: MapRows | None = None,
    sigma_deg: MapRows | None = None,
    resume: bool = False,
    on_progress: Progress = no_progress,
) -> BlockSurface:
    """Integrate a normal map that is larger than memory.

    The result is that of `integrate` up to a small error, which is estimated. Blocks of rows are
    solved one after the other; the solutions of neighbours are then corrected in rounds by a coarse
    Poisson problem over the complete map and by the changes at the outermost rows of each block
    (restricted additive Schwarz with a coarse space: Cai and Sarkis, 1999; combined as by Anderson,
    1965), until the estimated error is below a few parts in 10,000 of the range.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors, 0 outside the mask.
    mask
        ``(H, W)`` bool, the pixels with a normal.
    folder
        Existing folder of the files; up to 40 bytes per pixel, and 44 with a camera.
    rows
        Most rows of a block; `surface_memory` is what they need.
    camera, pixel_mm
        As for `integrate`.
    depth_mm
        ``(H, W)`` approximate depth, as for `integrate`.
    sigma_deg
        ``(H, W)`` float32 standard deviations of the normals, as for `integrate`.
    resume
        Leave the result of each step in the folder, and continue after the last step that an
        earlier call with the same arguments left there, with its blocks if they have no more than
        ``rows``. Default: begin at the first step.
    on_progress
        Receives the stages ``integrating``, ``joining blocks`` and ``placing``, in blocks.

    Returns
    -------
    BlockSurface
        The surface, which has to be closed.

    Raises
    ------
    DataError, EstimateError
        As `integrate`.
    StorageError
        If the disk refuses a file.

    Examples
    --------
    >>> import numpy as np
    >>> from pathlib import Path
    >>> from processing import NormalMap, integrate_in_blocks
    >>> y, x = np.mgrid[1:-1:96j, -1:1:40j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> surface = integrate_in_blocks(bowl.normals, bowl.mask, Path("."), rows=32)
    >>> surface.blocks, surface.height[0:2].shape
    (3, (2, 40))
    >>> surface.close()
    """
    scale = scale_of(camera, pixel_mm)
    size = _check(normals, mask, camera, depth_mm, scale)
    relative = None if sigma_deg is None else relative_variances(sigma_deg, mask)
    shape = integrability(normals, mask)
    files = BlockFiles(folder, size, rows, resume=resume)
    blocks = files.blocks
    solved = solve_in_blocks(normals, relative, camera, files, folder, on_progress)
    if not resume:
        files.remove()
    pixels = int(solved.sizes.sum())
    if not pixels:
        raise EstimateError(
            "no two neighbouring pixels of the normal map face the camera, so there is nothing to "
            "integrate: check the axes of the map (Z toward the camera) and its mask"
        )
    step = scale.step_px if camera is None else -scale.step_px
    angle_deg = angle_between_deg(step * solved.wanted, step * solved.found)
    height, depth, inside, (lowest, highest) = _placed(
        solved, blocks, scale, depth_mm, folder, on_progress
    )
    per_step = scale.pixel_size if scale.distance is None else scale.distance
    error = solved.rounds.error * per_step
    notices = [
        *parts_notices(len(solved.means), int(np.count_nonzero(mask)) - pixels),
        *doubts_of_solution(solved.worst),
        *consistency_warning(angle_deg, shape),
    ]
    if not solved.rounds.settled:
        share = error / (highest - lowest) if highest > lowest else 0.0
        text = (
            f"after {solved.rounds.number} rounds, the surface differs from that of the whole by "
            f"about {share:.2%} of its range: use more memory"
        )
        notices.append(Notice("blocks-not-settled", text))
    return BlockSurface(
        height=height,
        depth=depth,
        mask=inside,
        parts=solved.parts,
        unit=scale.unit,
        pixel_size=scale.pixel_size,
        camera=camera,
        pixels=pixels,
        part_count=len(solved.means),
        lowest=lowest,
        highest=highest,
        iterations=solved.worst.iterations,
        relative_residual=solved.worst.relative_residual,
        blocks=len(blocks.blocks),
        rounds=solved.rounds.number,
        error=error,
        disagreement_deg=angle_deg,
        curl=shape.curl,
        warnings=tuple(notices),
    )


def _check(
    normals: MapRows,
    mask: Mask,
    camera: CameraModel | None,
    depth_mm: MapRows | None,
    scale: Scale,
) -> tuple[int, int]:
    """Return the size of the map; raise `DataError` if inputs do not fit."""
    height, width = mask.shape
    if normals.shape != (height, width, 3):
        raise DataError(f"normals of shape {normals.shape} do not fit a mask of {mask.shape}")
    if not mask.any():
        raise DataError("a normal map with an empty mask holds no normal: check the mask")
    if camera is not None and camera.size != (height, width):
        raise DataError(
            f"a camera of {camera.width} x {camera.height} pixels does not fit a normal map of "
            f"{width} x {height}: crop or replace the camera"
        )
    if depth_mm is not None:
        _check_depths(depth_mm, mask, camera, scale)
    return height, width


def _check_depths(depth_mm: MapRows, mask: Mask, camera: CameraModel | None, scale: Scale) -> None:
    if scale.unit != "mm":
        raise DataError("approximate depths require a camera with a working distance")
    height, width = mask.shape
    kind = "finite" if camera is None else "positive"
    fits = depth_mm.shape == mask.shape
    for rows in rows_in_bands(height, width, _READ) if fits else ():
        values = depth_mm[rows][mask[rows]]
        fits &= bool((np.isfinite(values) if camera is None else values > 0).all())
    if not fits:
        raise DataError(
            f"approximate depths of shape {depth_mm.shape} must be {kind} at all pixels of a "
            f"normal map of shape {mask.shape}"
        )


def _placed(
    solved: BlockSolution,
    blocks: Blocks,
    scale: Scale,
    near: MapRows | None,
    folder: Path,
    on_progress: Progress,
) -> tuple[BandFile, BandFile | None, Mask, tuple[float, float]]:
    """Write heights and depths in their unit; return them, their pixels and their range."""
    form = solved.u.shape, np.dtype(np.float32)
    height = BandFile(folder / "height.raw", *form)
    depth = None if scale.distance is None else BandFile(folder / "depth.raw", *form)
    raised, factors = np.zeros(len(solved.means)), np.ones(len(solved.means))
    near_means = None if near is None else _part_means(solved, blocks, near)
    if scale.distance is not None:
        wanted = scale.distance if near_means is None else near_means
        factors = wanted / _mean_depths(solved, blocks)
    elif near_means is not None:
        raised = -near_means
    known = np.zeros(solved.u.shape, np.bool_)
    lowest, highest = math.inf, -math.inf
    on_progress("placing", 0, len(blocks.blocks))
    for number, block in enumerate(blocks.blocks):
        rows = block.core
        labels = solved.parts[rows]
        known[rows] = inside = labels >= 0
        members = labels[inside]
        u = solved.u[rows][inside] - solved.means[members]
        values = np.full(labels.shape, np.nan, np.float32)
        if depth is None or scale.distance is None:
            found = scale.pixel_size * u + raised[members]
        else:
            values[inside] = depths = np.exp(u) * factors[members]
            depth[rows] = values
            found = scale.distance - depths
        values[inside] = found
        height[rows] = values
        if len(found):
            lowest = min(lowest, float(values[inside].min()))
            highest = max(highest, float(values[inside].max()))
        on_progress("placing", number + 1, len(blocks.blocks))
    solved.u.close()
    solved.u.path.unlink()
    return height, depth, known, (lowest, highest)


def _part_means(solved: BlockSolution, blocks: Blocks, values: MapRows) -> Double:
    """Return the mean over each part of the rows of a map."""
    sums = np.zeros(len(solved.means))
    for block in blocks.blocks:
        labels = solved.parts[block.core]
        inside = labels >= 0
        sums += np.bincount(labels[inside], values[block.core][inside], len(sums))
    return np.asarray(sums / solved.sizes, np.float64)


def _mean_depths(solved: BlockSolution, blocks: Blocks) -> Double:
    """Return the mean depth of each part for a logarithm of the depth with mean 0."""
    sums = np.zeros(len(solved.means))
    for block in blocks.blocks:
        labels = solved.parts[block.core]
        inside = labels >= 0
        u = solved.u[block.core][inside] - solved.means[labels[inside]]
        if len(u) and np.abs(u).max() > math.log(DEPTH_RANGE):
            raise EstimateError(
                f"the depth would vary by more than a factor of {DEPTH_RANGE:g}: the camera matrix "
                "does not belong to this normal map, or the axes of the map are wrong"
            )
        sums += np.bincount(labels[inside], np.exp(u), len(sums))
    return np.asarray(sums / solved.sizes, np.float64)
