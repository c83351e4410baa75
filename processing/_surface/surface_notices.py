"""Notices about the parts of a surface and about its solution."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from processing._surface.jumps import Jumps
from processing._surface.multigrid import Solution
from rig import Notice

Labels = npt.NDArray[np.int32]


def doubts_of_parts(parts: Labels, isolated: int, jumps: Jumps | None) -> list[Notice]:
    """Return notices about heights that are not known.

    Parameters
    ----------
    parts
        ``(H, W)`` int32 number of the connected part of each pixel, -1 outside.
    isolated
        Number of pixels of the mask without a height.
    jumps
        Where the surface jumps, if that is known.
    """
    warnings = []
    count = int(parts.max()) + 1
    if count > 1:
        text = (
            f"the surface consists of {count} parts that are not connected: the mean height of "
            "each part is arbitrary, so their heights relative to each other are not known"
        )
        warnings.append(Notice("surface-in-parts", text))
    if isolated:
        one = "1 pixel of the mask is isolated or faces away from the camera and has no height"
        many = (
            f"{isolated} pixels of the mask are isolated or face away from the camera and have no "
            "height"
        )
        text = one if isolated == 1 else many
        warnings.append(Notice("pixels-without-height", text))
    guessed, share = (0, 0.0) if jumps is None else _guessed(jumps.pieces, parts)
    if guessed:
        which = "1 piece hangs" if guessed == 1 else f"{guessed} pieces hang"
        text = (
            f"{which} together with the rest of the surface across jumps only ({share:.1%} of the "
            "surface): the height relative to the rest is a guess"
        )
        warnings.append(Notice("height-guessed", text))
    if jumps is not None and not jumps.settled:
        text = (
            f"the surface still moved in the last of {jumps.rounds} rounds, by "
            f"{jumps.last_change:.2g} px on average: near jumps, its height may be inaccurate"
        )
        warnings.append(Notice("jumps-not-settled", text, "", "info"))
    return warnings


def doubts_of_solution(solution: Solution) -> list[Notice]:
    """Return a notice if the solver stopped early."""
    if solution.converged:
        return []
    text = (
        f"the solver stopped at a relative residual of {solution.relative_residual:.1e} after "
        f"{solution.iterations} iterations: heights may be inaccurate over long distances"
    )
    return [Notice("solver-not-converged", text)]


def _guessed(pieces: Labels, parts: Labels) -> tuple[int, float]:
    """Return the number of pieces that are not the largest of their part, and their share."""
    inside = pieces >= 0
    _, first, sizes = np.unique(pieces[inside], return_index=True, return_counts=True)
    _, largest = np.unique(parts[inside][first], return_index=True)
    return len(sizes) - len(largest), 1 - float(sizes[largest].sum() / sizes.sum())
