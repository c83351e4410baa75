"""How much heights change if the samples of a recording are others."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from acquisition import Lights
from calibration import EstimateError
from processing.checks.arrangement import Stored, residual_of
from processing.checks.block_model import BlockModel, light_vectors
from processing.maps.normal_map import NormalMap
from processing.surface.integration import integrate
from rig.arrays import Float64, Intp

# Blocks that show the mean height.
_BLOCKS = 300
# Mean heights are sought up to this share of the distance of the lights, in so many steps, and then
# to this share.
_RANGE, _STEPS, _EXACT = 0.4, 9, 1e-3


def sparse_blocks(model: BlockModel) -> Intp:
    """Return every second block of each second row."""
    rows, across = np.divmod(model.places, model.shape[1])
    return np.flatnonzero(model.valid & (rows % 2 == 0) & (across % 2 == 0))


def height_effect_mm(
    model: BlockModel,
    samples: Float64,
    lights: Lights,
    rays: Float64 | None,
    block_mm: float,
) -> float:
    """Return the root mean square change of the heights; NaN if there is no surface.

    Parameters
    ----------
    model
        The blocks.
    samples
        ``(B, N)`` other samples of `sparse_blocks`.
    lights
        The lights.
    rays
        ``(P, 3)`` change of the surface points per mm of height; None under distant lights.
    block_mm
        Side of a block.
    """
    blocks = sparse_blocks(model)
    moved = model.scaled_normals[blocks] + model.answer(blocks, samples - model.samples[blocks])
    rows, across = np.divmod(model.places[blocks], model.shape[1])
    maps = []
    for scaled in (model.scaled_normals[blocks], moved):
        grid = np.zeros((*(-(-length // 2) for length in model.shape), 3), np.float32)
        grid[rows // 2, across // 2] = scaled
        try:
            maps.append(integrate(NormalMap.from_vectors(grid)))
        except EstimateError:  # no two neighbours face the camera
            return float("nan")
    both = maps[0].mask & maps[1].mask
    lower, upper = (each.height[both].astype(np.float64) for each in maps)
    relief = float(np.std(upper - lower)) * 2 * block_mm
    if rays is None or lights.positions_mm is None:
        return relief
    before, after = (
        mean_height(model, blocks, seen, lights, rays)[0]
        for seen in (model.samples[blocks], samples)
    )
    return float(np.hypot(relief, after - before))


def mean_height(
    model: BlockModel,
    blocks: Intp,
    samples: Float64,
    lights: Lights,
    rays: Float64 | None,
    stored: Stored | None = None,
) -> tuple[float, float]:
    """Return the rise in mm at which samples of blocks fit their lights best, and the residual.

    The surface does not rise under distant lights. Residuals are those of `residual_of`.
    """
    some = slice(None, None, max(1, -(-len(blocks) // _BLOCKS)))
    points = model.points[blocks[some]]
    seen = np.where(model.samples[blocks[some]] > 0, samples[some], np.nan)
    if rays is None or lights.positions_mm is None:
        return 0.0, residual_of(seen, light_vectors(lights, points), stored)
    along = rays[blocks[some]]
    away = float(np.mean(np.linalg.norm(lights.positions_mm, axis=1)))

    def residual(rise: float) -> float:
        return residual_of(seen, light_vectors(lights, points + rise * along), stored)

    steps = np.linspace(-_RANGE, _RANGE, _STEPS) * away
    best = int(np.argmin([residual(float(rise)) for rise in steps]))
    bounds = float(steps[max(best - 1, 0)]), float(steps[min(best + 1, len(steps) - 1)])
    found = minimize_scalar(
        residual, bounds=bounds, method="bounded", options={"xatol": _EXACT * away}
    )
    return float(found.x), float(found.fun)
