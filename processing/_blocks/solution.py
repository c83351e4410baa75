"""The solution of the Poisson problem of a surface in blocks of rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from acquisition import BandFile, CameraModel, MapRows
from processing._blocks.coarse import CoarseGrid
from processing._blocks.free_solution import SomeSteps, solve_freely
from processing._blocks.kernels import number_parts
from processing._blocks.local_parts import LocalParts
from processing._blocks.plan import Blocks
from processing._blocks.rounds import Rounds, bring_together
from processing._blocks.seams import Seam, Side
from processing._surface.multigrid import Solution
from rig import Progress

Float = npt.NDArray[np.float32]
Double = npt.NDArray[np.float64]

# Steps that show whether the surface has the slopes of the normals, in each direction.
_STEPS = 20_000
_NONE = Solution(np.zeros((0, 0)), 0, 0.0, converged=True)


class BlockSolution(NamedTuple):
    """The solution of a surface in files.

    Parameters
    ----------
    u
        ``(H, W)`` float64 solution.
    parts
        ``(H, W)`` int32 parts in reading order, -1 for pixels without edges.
    means, sizes
        Mean of the solution over each part, and number of its pixels.
    wanted, found
        Some steps that the normals demand, and those of the solution.
    rounds
        How the blocks were brought together; errors are those of the solution.
    worst
        What the solver reports about the block with the largest residual.
    """

    u: BandFile
    parts: BandFile
    means: Double
    sizes: npt.NDArray[np.int64]
    wanted: Double
    found: Double
    rounds: Rounds
    worst: Solution


def solve_in_blocks(
    normals: MapRows,
    relative: MapRows | None,
    blocks: Blocks,
    camera: CameraModel | None,
    folder: Path,
    on_progress: Progress,
) -> BlockSolution:
    """Solve the surface of normals.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, 0 where a normal is not known.
    relative
        ``(H, W)`` variances of the normals; None if all are equal.
    blocks
        The blocks.
    camera
        A perspective camera; None for an orthographic view.
    folder
        Folder of the files.
    on_progress
        Receives the stages ``integrating`` and ``joining blocks``.
    """
    height, width = normals.shape[:2]
    u = BandFile(folder / "solution.raw", (height, width), np.dtype(np.float64))
    parts = BandFile(folder / "parts.raw", (height, width), np.dtype(np.int32))
    weights = BandFile(folder / "weights.raw", (height, 2, width), np.dtype(np.float32))
    grid, local = CoarseGrid((height, width)), LocalParts()
    sides: list[tuple[Side, Side]] = []
    downs: list[Float] = []
    steps: list[SomeSteps] = []
    several: list[bool] = []
    worst = _NONE
    upper: Side | None = None
    shared, total = 2 * blocks.halo, len(blocks.blocks)
    on_progress("integrating", 0, total)
    for number, block in enumerate(blocks.blocks):
        free = solve_freely(normals, relative, block, camera, max(1, height * width // _STEPS))
        labels = local.add(free.labels, free.part_count)
        first = block.core.start - block.rows.start
        core = slice(first, first + block.core.stop - block.core.start)
        grid.add(block.core.start, free.right[core], free.down[core])
        weights[block.core] = np.stack([free.right[core], free.down[core]], axis=1)
        u[block.core], parts[block.core] = free.u[core], labels[core]
        steps.append(free.steps)
        several.append(free.part_count > 1)
        if free.solution.relative_residual >= worst.relative_residual:
            worst = replace(free.solution, u=_NONE.u)
        if upper is not None:
            lower = Side(free.u[:shared].copy(), labels[:shared].copy())
            local.meet(upper, lower)
            sides.append((upper, lower))
            downs[-1][blocks.halo :] = free.down[blocks.halo : shared]
        upper = Side(free.u[-shared:].copy(), labels[-shared:].copy())
        downs.append(free.down[-shared:].copy())
        del free, labels
        on_progress("integrating", number + 1, total)
    span = _add_constants(u, parts, local.constants(), blocks)
    seams = [
        _blended(u, parts, local.constants(), blocks, seam, sides[seam], downs[seam])
        for seam in range(len(sides))
    ]
    del sides
    rounds = Rounds(0, 0.0, settled=True)
    if seams:
        rounds = bring_together(blocks, seams, grid, weights, u, several, span, on_progress)
    weights.close()
    weights.path.unlink()
    part_of, count = local.joined()
    numbers = np.full(count, -1, np.int32)
    sums, sizes = np.zeros(count), np.zeros(count, np.int64)
    wanted, found = [], []
    for block, some in zip(blocks.blocks, steps, strict=True):
        values, labels = u[block.core], parts[block.core]
        number_parts(values, labels, part_of, numbers, sums, sizes)
        parts[block.core] = labels
        wanted.append(some.steps)
        found.append(values.ravel()[some.there] - values.ravel()[some.here])
    return BlockSolution(
        u,
        parts,
        sums / np.maximum(sizes, 1),
        sizes,
        np.concatenate(wanted),
        np.concatenate(found),
        rounds,
        worst,
    )


def _add_constants(u: BandFile, parts: BandFile, constants: Double, blocks: Blocks) -> float:
    """Add the constant of each part of a block; return the range of the solution."""
    lowest, highest = np.inf, -np.inf
    for block in blocks.blocks:
        labels = parts[block.core]
        inside = labels >= 0
        if not inside.any():
            continue
        values = u[block.core]
        values[inside] += constants[labels[inside]]
        u[block.core] = values
        lowest = min(lowest, float(values[inside].min()))
        highest = max(highest, float(values[inside].max()))
    return max(highest - lowest, 0.0)


def _blended(
    u: BandFile,
    parts: BandFile,
    constants: Double,
    blocks: Blocks,
    seam: int,
    sides: tuple[Side, Side],
    down: Float,
) -> Seam:
    """Write the blend of both solutions of shared rows, and return the seam."""
    rows, share = blocks.shared(seam), blocks.share_of_upper()
    upper, lower = (side.u + np.append(constants, 0)[side.labels] for side in sides)
    has_upper, has_lower = (side.labels >= 0 for side in sides)
    difference = np.where(has_upper & has_lower, upper - lower, 0)
    # Only pixels of the outermost rows may have one solution: the other block has no share there.
    u[rows] = np.where(has_lower, lower + share[:, None] * difference, upper)
    u[rows] = np.where(has_upper | has_lower, u[rows], 0)
    parts[rows] = np.maximum(sides[0].labels, sides[1].labels)
    return Seam(rows, share, down, difference)
