"""The solution of one block alone, free at its cut edges."""

from __future__ import annotations

import numpy as np

from acquisition import CameraModel, MapRows
from processing.surface.blocks.block_files import BlockFiles, Record
from processing.surface.blocks.block_solutions import Side
from processing.surface.blocks.kernels import extremes
from processing.surface.blocks.local_parts import NO_MEETING, meeting_of
from processing.surface.chord_rule import ChordRule
from processing.surface.consistency import some_steps
from processing.surface.edge_certainty import certainties
from processing.surface.grid_graph import divergence, label_parts
from processing.surface.multigrid import solve
from rig.arrays import Float32, Float64

# Steps that show whether the surface has the slopes of the normals, in each direction.
_STEPS = 20_000


def solve_freely(
    normals: MapRows,
    relative: MapRows | None,
    camera: CameraModel | None,
    files: BlockFiles,
    number: int,
    before: int,
    jumps: bool,
) -> Record:
    """Solve one block, write its solution, its parts and its weights, and return their record.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, 0 where a normal is not known.
    relative
        ``(H, W)`` variances of the normals; None if all are equal.
    camera
        A perspective camera; None for an orthographic view.
    files
        Files of the blocks.
    number
        Number of the block.
    before
        Number of parts of the blocks above.
    jumps
        Whether the files have the edges of a surface that jumps.
    """
    height, width = normals.shape[:2]
    block, shared = files.blocks.blocks[number], 2 * files.blocks.halo
    if jumps:
        edges = files.edges_of_jumps(block.rows)
    else:
        edges = _smooth_edges(normals, relative, camera, block.rows)
    right, down, step_right, step_down = edges
    del edges
    leaving = down[-2].copy()
    down[-2] = 0
    labels, count = label_parts(right, down)
    first = block.inner.start + 1
    core = np.s_[first : first + block.core.stop - block.core.start, 1:-1]
    every = max(1, height * width // _STEPS)
    steps = some_steps(right[core], down[core], step_right[core], step_down[core], every)
    b = divergence(right, down, step_right, step_down)
    del step_right, step_down
    solution = solve(right, down, b)
    down[-2] = leaving
    own = Side(
        solution.u[1:-1, 1:-1],
        np.where(labels >= 0, labels + np.int32(before), np.int32(-1))[1:-1, 1:-1],
    )
    if not jumps:
        files.write_weights(number, np.stack([right[core], down[core]], axis=1))
    files.write(f"solution-{number}-0", own.u)
    files.write(f"labels-{number}", own.labels)
    meeting = NO_MEETING
    if number:
        names = f"solution-{number - 1}-0", f"labels-{number - 1}"
        upper = Side(*(files.read(name, slice(-shared, None)) for name in names))
        meeting = meeting_of(upper, Side(own.u[:shared], own.labels[:shared]))
    return files.complete(
        f"free-{number}",
        count=count,
        extremes=extremes(solution.u[core], labels[core], count),
        iterations=solution.iterations,
        relative_residual=solution.relative_residual,
        converged=solution.converged,
        **meeting._asdict(),
        **steps._asdict(),
    )


def _smooth_edges(
    normals: MapRows, relative: MapRows | None, camera: CameraModel | None, rows: slice
) -> tuple[Float32, Float32, Float64, Float64]:
    """Return weights and steps of the edges of rows, in a border without edges of these rows."""
    height, width = normals.shape[:2]
    # A step depends on the normals before and after its edge, too.
    wide = slice(max(rows.start - 1, 0), min(rows.stop + 1, height))
    vectors = np.ascontiguousarray(normals[wide], np.float32)
    inside = np.asarray(vectors.any(axis=2), np.bool_)
    edges = ChordRule((wide, slice(0, width)), camera, smooth=True).edges(vectors, inside)
    kept = slice(rows.start - wide.start, rows.stop - wide.start + 2)
    right, down = np.ascontiguousarray(edges[0][kept]), np.ascontiguousarray(edges[1][kept])
    # Pixels of the margin become the border without edges.
    right[[0, -1]] = down[[0, -1]] = 0
    if relative is not None:
        factors = certainties(relative[slice(rows.start, min(rows.stop + 1, height))])
        right *= factors[0][: len(right)]
        down *= factors[1][: len(down)]
    return right, down, edges[2][kept], edges[3][kept]
