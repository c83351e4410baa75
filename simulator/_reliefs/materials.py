"""The simulator's materials and coin as reliefs, with random sizes, directions and seeds."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from simulator._shapes.carved import CrackedLeather, Textile
from simulator._shapes.coin import Coin
from simulator._shapes.surface import Surface

Array = npt.NDArray[np.float64]
Random = np.random.Generator


def material(random: Random, size: int) -> Array:
    """Return cloth, leather or a part of a coin.

    `LizardScales` and `WoodCarving` are left out: they are for judging what was trained on others.

    Parameters
    ----------
    random
        Source of random numbers.
    size
        Side of the square in pixels.

    Returns
    -------
    Array
        ``(size, size)`` heights in pixels.
    """
    seed = int(random.integers(2**31))
    surface: Surface
    kind = random.integers(3)
    if kind == 0:
        surface = Textile(size, seed=seed, yarn_mm=random.uniform(8, 40))
    elif kind == 1:
        surface = CrackedLeather(size, seed=seed, plate_mm=random.uniform(16, 80))
    else:
        radius = random.uniform(0.5, 1.5) * size
        surface = Coin(radius, dome_mm=random.uniform(0.01, 0.1) * radius, seed=seed)
    y, x = np.mgrid[:size, :size] - size / 2 + random.uniform(-0.3, 0.3, (2, 1, 1)) * size
    angle = random.uniform(0, 2 * math.pi)
    c, s = math.cos(angle), math.sin(angle)
    return surface.evaluate(c * x + s * y, c * y - s * x)[0]
