"""The solution of the Poisson problem of a surface in blocks of rows."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from acquisition import CameraModel, MapRows
from acquisition.files import BandStore
from processing.surface.blocks.block_files import BlockFiles, Record
from processing.surface.blocks.block_jumps import CoarseJumps, coarse_jumps, find_jumps
from processing.surface.blocks.block_solutions import OwnSolutions
from processing.surface.blocks.coarse import CoarseGrid
from processing.surface.blocks.corrections import Rounds, bring_together
from processing.surface.blocks.free_solution import solve_freely
from processing.surface.blocks.kernels import number_parts
from processing.surface.blocks.local_parts import LocalParts, Meeting
from processing.surface.blocks.plan import Blocks
from processing.surface.jumps import Jumps
from processing.surface.multigrid import Solution
from rig import Progress
from rig.arrays import Bool, Float64, Int32, Int64


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
    blocks
        The blocks.
    rounds
        How they were brought together; errors are those of the solution.
    worst
        What the solver reports about the block with the largest residual.
    jumps
        Where it jumps; None if it is smooth.
    """

    u: MapRows
    parts: MapRows
    means: Float64
    sizes: Int64
    wanted: Float64
    found: Float64
    blocks: Blocks
    rounds: Rounds
    worst: Solution
    jumps: Jumps | None

    def part_means(self, values: Callable[[slice, Bool, Int32], Float64]) -> Float64:
        """Return the mean over each part.

        ``values`` returns those of the pixels of rows that have a part, from the rows, which
        pixels these are, and their parts.
        """
        sums = np.zeros(len(self.means))
        for block in self.blocks.blocks:
            labels = self.parts[block.core]
            inside = labels >= 0
            members = labels[inside]
            sums += np.bincount(members, values(block.core, inside, members), len(sums))
        return np.asarray(sums / self.sizes, np.float64)

    def centred(self, rows: slice, inside: Bool, members: Int32) -> Float64:
        """Return the solution minus its mean over each part, as `part_means` needs it."""
        return np.asarray(self.u[rows][inside] - self.means[members], np.float64)


def solve_in_blocks(
    normals: MapRows,
    relative: MapRows | None,
    camera: CameraModel | None,
    store: BandStore,
    rows: int,
    discontinuity: bool | None,
    k: float,
    on_progress: Progress,
) -> BlockSolution:
    """Solve the surface of normals.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, 0 where a normal is not known.
    relative
        ``(H, W)`` variances of the normals; None if all are equal.
    camera
        A perspective camera; None for an orthographic view.
    store
        Its maps ``solution`` and ``parts`` are filled. Steps that are in its folder are not
        repeated.
    rows
        Most rows of a block.
    discontinuity, k
        As for `integrate`.
    on_progress
        Receives the stages ``integrating`` and ``joining blocks``.
    """
    height, width = normals.shape[:2]
    files = BlockFiles(store.folder, (height, width), rows)
    blocks = files.blocks
    count, total = 0, len(blocks.blocks)
    frees: list[Record] = []
    on_progress("integrating", 0, total)
    coarse = coarse_jumps(normals, camera, files, discontinuity, k)
    if coarse is not None:
        for number in range(total):
            find_jumps(coarse, normals, relative, camera, files, number)
    for number in range(total):
        free = files.record(f"free-{number}")
        if free is None:
            free = solve_freely(normals, relative, camera, files, number, count, coarse is not None)
        count += int(free["count"])
        frees.append(free)
        on_progress("integrating", number + 1, total)
    meetings = [[free[name] for free in frees] for name in Meeting._fields]
    local = LocalParts(count, Meeting(*(np.concatenate(each, axis=-1) for each in meetings)))
    own = OwnSolutions(files, local.constants())
    rounds = _rounds(own, frees, (height, width), on_progress)
    files.close_weights()
    u, parts = store["solution"], store["parts"]
    part_of, count = local.joined()
    numbers = np.full(count, -1, np.int32)
    sums, sizes = np.zeros(count), np.zeros(count, np.int64)
    found = []
    for number, (block, free) in enumerate(zip(blocks.blocks, frees, strict=True)):
        core = own.blended(number)
        number_parts(core.u, core.labels, part_of, numbers, sums, sizes)
        u[block.core], parts[block.core] = core.u, core.labels
        found.append(core.u.ravel()[free["there"]] - core.u.ravel()[free["here"]])
    jumps = None if coarse is None else _jumps(files, coarse, parts, height, width)
    worst = max(frees, key=lambda free: float(free["relative_residual"]))
    return BlockSolution(
        u,
        parts,
        sums / np.maximum(sizes, 1),
        sizes,
        np.concatenate([free["steps"] for free in frees]),
        np.concatenate(found),
        blocks,
        rounds,
        Solution(
            np.zeros((0, 0)),
            int(worst["iterations"]),
            float(worst["relative_residual"]),
            converged=bool(worst["converged"]),
        ),
        jumps,
    )


def _jumps(
    files: BlockFiles, coarse: CoarseJumps, parts: MapRows, height: int, width: int
) -> Jumps:
    """Return the jumps in all blocks."""
    flags = np.zeros((height, width), np.uint8)
    doubt = np.zeros((height, width), np.float32)
    for number, block in enumerate(files.blocks.blocks):
        flags[block.core] = files.read(f"flags-{number}", block.inner)
        doubt[block.core] = files.read(f"doubt-{number}", block.inner)
    pieces = coarse.pieces_of(~np.isnan(doubt))
    return Jumps((flags & 1) > 0, (flags & 2) > 0, doubt, pieces, coarse.rounds, 0, settled=True)


def _rounds(
    own: OwnSolutions, frees: list[Record], size: tuple[int, int], on_progress: Progress
) -> Rounds:
    """Bring the solutions together, unless an earlier process did."""
    files = own.files
    done = files.record("rounds")
    if done is None:
        grid = CoarseGrid(size)
        for number, block in enumerate(own.blocks.blocks):
            weights = files.core_weights(number)
            grid.add(block.core.start, weights[:, 0], weights[:, 1])
        several = [int(free["count"]) > 1 for free in frees]
        ends = np.concatenate([free["extremes"] for free in frees], axis=1) + own.constants
        span = max(float(ends[1].max(initial=-np.inf) - ends[0].min(initial=np.inf)), 0.0)
        done = files.complete(
            "rounds", **bring_together(own, grid, several, span, on_progress)._asdict()
        )
    rounds = Rounds(int(done["number"]), float(done["error"]), bool(done["settled"]))
    own.all_advanced(rounds.number)
    return rounds
