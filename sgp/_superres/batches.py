"""Random crops of random surfaces, turned and mirrored."""

from __future__ import annotations

import numpy as np

from sgp._superres.pair_files import PairFiles
from sgp._superres.pairs import Float

SYMMETRIES = 8


def turned(normals: Float, symmetry: int) -> Float:
    """Return a map turned or mirrored, its vectors too.

    Parameters
    ----------
    normals
        ``(h, w, 3)`` normals or details in the house frame: X right, Y up.
    symmetry
        0 to 7: mirrored horizontally (1), vertically (2), at the diagonal (4), or several of them.
    """
    if symmetry & 1:
        normals = normals[:, ::-1] * _vector(-1, 1, 1)
    if symmetry & 2:
        normals = normals[::-1] * _vector(1, -1, 1)
    if symmetry & 4:
        # Rows grow downwards, Y upwards.
        normals = normals.transpose(1, 0, 2)[..., [1, 0, 2]] * _vector(-1, -1, 1)
    return normals


def batch(pairs: PairFiles, count: int, side: int, key: tuple[int, int]) -> tuple[Float, Float]:
    """Return the crops of one step; they depend on the key alone, not on earlier steps.

    Parameters
    ----------
    pairs
        The pairs to choose from.
    count
        Number of crops.
    side
        Side of the crops in pixels of low resolution.
    key
        Seed of the training, and number of the step.

    Returns
    -------
    low, high
        ``(count, side, side, 3)`` and ``(count, s side, s side, 3)`` float32.
    """
    random = np.random.default_rng(key)
    crops = []
    for _ in range(count):
        index, symmetry = int(random.integers(len(pairs))), int(random.integers(SYMMETRIES))
        top, left = random.integers(0, len(pairs.low[index]) - side + 1, 2)
        crops.append([turned(one, symmetry) for one in pairs.crop(index, top, left, side)])
    low, high = zip(*crops, strict=True)
    return np.stack(low), np.stack(high)


def _vector(*values: float) -> Float:
    return np.array(values, np.float32)
