"""Notices about the parts of a surface and about its solution."""

from __future__ import annotations

import numpy as np

from acquisition.files import MapRows
from processing.surface.guesses import Guesses
from processing.surface.jumps import Jumps
from processing.surface.multigrid import Solution
from rig import Notice, figure, pluralize
from rig.arrays import Bool, Int32


def doubts_of_parts(
    parts: Int32, isolated: int, jumps: Jumps | None, known: Bool | None = None
) -> list[Notice]:
    """Return notices about heights that are not known.

    Parameters
    ----------
    parts
        ``(H, W)`` int32 number of the connected part of each pixel, -1 outside.
    isolated
        Number of pixels of the mask without a height.
    jumps
        Where the surface jumps, if that is known.
    known
        ``(H, W)`` bool, pixels whose heights are known from elsewhere.
    """
    count = int(parts.max()) + 1
    held = 0 if known is None else len(np.unique(parts[known & (parts >= 0)]))
    return [*parts_notices(count, isolated, held), *doubts_of_jumps(jumps, parts, known)]


def doubts_of_jumps(jumps: Jumps | None, parts: MapRows, known: Bool | None = None) -> list[Notice]:
    """Return notices about heights across jumps; parameters as for `doubts_of_parts`."""
    if jumps is None:
        return []
    warnings = []
    guesses = Guesses.of(jumps.pieces, parts, known)
    if guesses.number:
        which = "1 piece hangs" if guesses.number == 1 else f"{guesses.number} pieces hang"
        text = (
            f"{which} together with the rest of the surface across jumps only "
            f"({guesses.share:.1%} of the surface): the height relative to the rest is a guess"
        )
        warnings.append(Notice("height-guessed", text))
    if not jumps.settled:
        text = (
            f"the surface still moved in the last of {jumps.rounds} rounds, by "
            f"{figure(jumps.last_change)} px on average: near jumps, its height may be inaccurate"
        )
        warnings.append(Notice("jumps-not-settled", text, "", "info"))
    return warnings


def parts_notices(count: int, isolated: int, held: int = 0) -> list[Notice]:
    """Return notices about separate parts and pixels without a height.

    Parameters
    ----------
    count
        Number of parts.
    isolated
        Number of pixels of the mask without a height.
    held
        Number of parts whose heights are known from elsewhere.
    """
    warnings = []
    if count > 1 and held < count:
        which = "each part" if not held else f"{count - held} of them, without a prior,"
        text = (
            f"the surface consists of {count} parts that are not connected: the mean height of "
            f"{which} is arbitrary, so their heights relative to each other are not known"
        )
        warnings.append(Notice("surface-in-parts", text))
    if isolated:
        text = pluralize(
            isolated,
            "pixel of the mask is isolated or faces away from the camera and has no height",
            "pixels of the mask are isolated or face away from the camera and have no height",
        )
        warnings.append(Notice("pixels-without-height", text))
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
