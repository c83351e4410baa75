"""Reliefs of cells: cracks, pebbles, plates and bricks around jittered points."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from simulator._reliefs.noise import power_noise

Array = npt.NDArray[np.float64]
Random = np.random.Generator


def cells(random: Random, size: int) -> Array:
    """Return a relief from the distances to the two nearest points (Worley 1996).

    Parameters
    ----------
    random
        Source of random numbers.
    size
        Side of the square in pixels; cells are 8 to 48 pixels wide.

    Returns
    -------
    Array
        ``(size, size)`` heights, about 1 high.
    """
    width = random.uniform(8, 48)
    points = _rows(random, size, width) if random.random() < 0.4 else _anywhere(random, size, width)
    first, second, nearest = _distances(random, size, width, points)
    gap = (second - first) / width
    kind = random.integers(4)
    if kind == 0:  # cracks
        return -np.exp(-((gap / random.uniform(0.05, 0.4)) ** 2))
    if kind == 1:  # pebbles
        steepness = random.uniform(0.8, 1.6)
        return np.sqrt(np.maximum(1 - steepness * (first / width) ** 2, 0))
    if kind == 2:  # plates with joints
        return np.tanh(gap / random.uniform(0.1, 0.5))
    levels = random.uniform(0, 1, len(points))[nearest]  # plates on several levels
    return np.asarray(levels * random.uniform(0.2, 1) + 0.3 * np.tanh(gap / 0.2))


def _anywhere(random: Random, size: int, width: float) -> Array:
    """Return points anywhere, also around the square, so that its edge looks like its middle."""
    count = int((size / width + 4) ** 2)
    return random.uniform(-2 * width, size + 2 * width, (count, 2))


def _rows(random: Random, size: int, width: float) -> Array:
    """Return a jittered grid, its odd rows shifted by half a cell or not."""
    steps = np.arange(-2, size / width + 4)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    grid[:, 0] += grid[:, 1] % 2 / 2 * random.integers(2)
    jitter = random.normal(0, random.uniform(0, 0.3), grid.shape)
    return np.asarray(width * (grid + jitter))


def _distances(
    random: Random, size: int, width: float, points: Array
) -> tuple[Array, Array, npt.NDArray[np.intp]]:
    """Return the distances to the two nearest points, in a warped plane, and which is nearest."""
    y, x = np.mgrid[:size, :size].astype(float)
    bend = random.uniform(0, 0.35) * width
    x, y = x + bend * power_noise(random, size, 2.0), y + bend * power_noise(random, size, 2.0)
    found = cKDTree(points).query(np.stack([x, y], -1), k=2)
    distances, indices = np.asarray(found[0]), np.asarray(found[1], np.intp)
    return distances[..., 0], distances[..., 1], indices[..., 0]
