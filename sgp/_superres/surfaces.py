"""The simulated surfaces on which networks are judged."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

import simulator
from sgp._superres.presets import RUGGED_SCALES


def surface(seed: int, side: int, scale: int) -> npt.NDArray[np.float32]:
    """Return normals to judge a network on, of the kinds that its training had.

    They are random ones, at scale 4 rugged ones for odd seeds.

    Parameters
    ----------
    seed
        Fixes everything.
    side
        Side of the square in pixels.
    scale
        Scale of the network.
    """
    rugged = scale in RUGGED_SCALES and seed % 2
    make = simulator.rugged_normals if rugged else simulator.random_normals
    return make(seed, side)
