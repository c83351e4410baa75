"""The solution of one block alone, free at its cut edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acquisition import CameraModel, MapRows
from processing.surface.blocks.plan import Block
from processing.surface.chord_rule import ChordRule
from processing.surface.consistency import SomeSteps, some_steps
from processing.surface.edge_certainty import certainties
from processing.surface.grid_graph import divergence, label_parts
from processing.surface.multigrid import Solution, solve
from rig.arrays import Float32, Float64, Int32


class FreeSolution(NamedTuple):
    """The solution of one block.

    Parameters
    ----------
    u
        ``(h, W)`` solution, up to a constant for each part.
    right, down
        ``(h, W)`` float32 weights of the edges to the right and down.
    labels, part_count
        ``(h, W)`` part of each pixel, -1 without edges, and the number of parts.
    steps
        Some steps between pixels of the core.
    solution
        What the solver reports.
    """

    u: Float64
    right: Float32
    down: Float32
    labels: Int32
    part_count: int
    steps: SomeSteps
    solution: Solution


def solve_freely(
    normals: MapRows,
    relative: MapRows | None,
    block: Block,
    camera: CameraModel | None,
    every: int,
) -> FreeSolution:
    """Solve one block.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, 0 where a normal is not known.
    relative
        ``(H, W)`` variances of the normals; None if all are equal.
    block
        The block.
    camera
        A perspective camera; None for an orthographic view.
    every
        Which share of the steps is returned.
    """
    height, width = normals.shape[:2]
    rows = block.rows
    # A step depends on the normals before and after its edge, too.
    wide = slice(max(rows.start - 1, 0), min(rows.stop + 1, height))
    vectors = np.ascontiguousarray(normals[wide], np.float32)
    inside = np.asarray(vectors.any(axis=2), np.bool_)
    edges = ChordRule((wide, slice(0, width)), camera, smooth=True).edges(vectors, inside)
    del vectors, inside
    kept = slice(rows.start - wide.start, rows.stop - wide.start + 2)
    right, down = np.ascontiguousarray(edges[0][kept]), np.ascontiguousarray(edges[1][kept])
    step_right, step_down = edges[2][kept], edges[3][kept]
    del edges
    # Pixels of the margin become the border without edges.
    right[[0, -1]] = down[[0, -1]] = 0
    leaving = down[-2].copy()
    if relative is not None:
        factors = certainties(relative[slice(rows.start, min(rows.stop + 1, height))])
        right *= factors[0][: len(right)]
        down *= factors[1][: len(down)]
        leaving *= factors[1][len(down) - 2]
    down[-2] = 0
    labels, count = label_parts(right, down)
    first = block.inner.start + 1
    core = np.s_[first : first + block.core.stop - block.core.start, 1:-1]
    steps = some_steps(right[core], down[core], step_right[core], step_down[core], every)
    b = divergence(right, down, step_right, step_down)
    del step_right, step_down
    solution = solve(right, down, b)
    inner = np.s_[1:-1, 1:-1]
    down[-2] = leaving
    return FreeSolution(
        solution.u[inner], right[inner], down[inner], labels[inner], count, steps, solution
    )
