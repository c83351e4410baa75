"""Jumps of a surface that is solved in blocks: searched in a map of large pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acquisition import CameraModel, MapRows
from acquisition.files import rows_in_bands
from processing.surface.blocks.block_files import BlockFiles
from processing.surface.blocks.plan import CELL
from processing.surface.chord_rule import ChordRule
from processing.surface.edge_certainty import certainties
from processing.surface.grid_graph import divergence
from processing.surface.jumps import (
    LEAST_SUSPECTS,
    CoarseSurface,
    JumpProblem,
    mean_normals,
)
from processing.surface.multigrid import solve
from rig.arrays import Bool, Float32, Float64, Int32

# Sides of the large pixels that are tried: blocks begin at multiples of the largest. The first
# is used that leaves at most this many large pixels.
_CELLS, _LARGE_PIXELS = (2, 4, CELL), 1_000_000
_BAND = 32 * CELL  # rows


class CoarseJumps(NamedTuple):
    """A surface with jumps in large pixels.

    Parameters
    ----------
    surface
        The surface.
    pieces
        ``(h, w)`` pieces, as in `Jumps`.
    rounds
        How often its weights and the surface were computed.
    k
        Sharpness of the sigmoid, in 1/px^2 of the image.
    scale
        What its heights are multiplied by in the image.
    """

    surface: CoarseSurface
    pieces: Int32
    rounds: int
    k: float
    scale: float

    def rows(self, rows: slice, columns: int) -> Float64:
        """Return the surface in rows of the image, with steps between its large pixels."""
        u, cell = self.surface
        first = rows.start // cell
        wide = u[first : -(-rows.stop // cell)].repeat(cell, axis=0).repeat(cell, axis=1)
        begin = rows.start - first * cell
        return self.scale * wide[begin : begin + rows.stop - rows.start, :columns]

    def pieces_of(self, inside: Bool) -> Int32:
        """Return the pieces in the image, -1 outside."""
        rows, columns = inside.shape
        cell = self.surface.cell
        wide = self.pieces.repeat(cell, axis=0)[:rows].repeat(cell, axis=1)[:, :columns]
        wide[~inside] = -1
        return wide


def coarse_jumps(
    normals: MapRows,
    camera: CameraModel | None,
    files: BlockFiles,
    discontinuity: bool | None,
    k: float,
) -> CoarseJumps | None:
    """Return the surface with jumps in large pixels; None if a smooth one is wanted or better.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32, 0 where a normal is not known.
    camera
        A perspective camera; None for an orthographic view.
    files
        Files of the blocks, which keep the result.
    discontinuity, k
        As for `integrate`.
    """
    if discontinuity is False:
        return None
    known = files.record("coarse")
    if known is None:
        pixels = normals.shape[0] * normals.shape[1]
        fits = (cell for cell in _CELLS if pixels <= _LARGE_PIXELS * cell**2)
        cell = next(fits, _CELLS[-1])
        found = _searched(normals, camera, discontinuity, k, cell)
        empty = np.zeros((0, 0)), np.zeros((0, 0), np.int32), 0
        u, pieces, rounds = empty if found is None else found
        known = files.complete("coarse", u=u, pieces=pieces, rounds=rounds, cell=cell)
    if not known["u"].size:
        return None
    surface = CoarseSurface(known["u"], int(known["cell"]))
    scale = 1.0 if camera is not None else float(surface.cell)
    return CoarseJumps(surface, known["pieces"], int(known["rounds"]), k, scale)


def _searched(
    normals: MapRows, camera: CameraModel | None, discontinuity: bool | None, k: float, cell: int
) -> tuple[Float64, Int32, int] | None:
    rows, columns = normals.shape[:2]
    bands = [
        mean_normals(np.asarray(normals[band], np.float32), cell)
        for band in rows_in_bands(rows, 1, _BAND)
    ]
    means: Float32 = np.concatenate([each for each, _ in bands])
    mask = np.concatenate([each for _, each in bands])
    chords = ChordRule((slice(0, rows), slice(0, columns)), camera, cell=cell)
    edges = chords.edges(means, mask)
    least = 0.0 if discontinuity else LEAST_SUSPECTS
    problem = JumpProblem.of(means, mask, chords, edges, k=k * cell**2, least=least)
    if problem is None:
        return None
    found, jumps, _ = problem.solved()
    if not discontinuity:
        chords.correct(means, edges[:2], edges[2:])
        smooth = solve(*edges[:2], divergence(*edges))
        if not problem.improves(found.u, smooth.u):
            return None
    return found.u[1:-1, 1:-1].copy(), jumps.pieces, jumps.rounds


def find_jumps(
    coarse: CoarseJumps,
    normals: MapRows,
    relative: MapRows | None,
    camera: CameraModel | None,
    files: BlockFiles,
    number: int,
) -> None:
    """Find the jumps of one block, from those in large pixels; write its weights and steps.

    Parameters
    ----------
    coarse
        The surface in large pixels.
    normals, camera
        As for `coarse_jumps`.
    relative
        ``(H, W)`` variances of the normals; None if all are equal.
    files
        Files of the blocks. The step is not repeated.
    number
        Number of the block.
    """
    if files.record(f"jumps-{number}") is not None:
        return
    block = files.blocks.blocks[number]
    vectors = np.ascontiguousarray(normals[block.rows], np.float32)
    inside = np.asarray(vectors.any(axis=2), np.bool_)
    factors = None if relative is None else certainties(relative[block.rows])
    chords = ChordRule((block.rows, slice(0, normals.shape[1])), camera)
    edges = chords.edges(vectors, inside)
    problem = JumpProblem.of(vectors, inside, chords, edges, k=coarse.k, factors=factors)
    if problem is None:
        raise AssertionError("a problem without a least share of suspects exists")
    # What holds pieces of the block together may be outside it.
    start = np.pad(coarse.rows(block.rows, normals.shape[1]), 1)
    problem = problem.near(start)
    del edges
    u, cell = coarse.surface
    part = u[block.rows.start // cell : -(-block.rows.stop // cell)]
    found, _ = problem.found(CoarseSurface(part, cell))
    right, down, doubt, _ = problem.judged(found.u)
    files.write(f"flags-{number}", right + np.uint8(2) * down)
    files.write(f"doubt-{number}", doubt)
    core = slice(block.inner.start + 1, block.inner.stop + 1)
    steps = problem.alternation.edges[2:]
    files.write_weights(number, np.stack([each[core, 1:-1] for each in found.weights], axis=1))
    files.write_steps(number, np.stack([each[core, 1:-1] for each in steps], axis=1))
    files.complete(f"jumps-{number}")
