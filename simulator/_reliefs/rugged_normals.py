"""Normals of rugged surfaces, as a measurement or a stored image gives them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

from simulator._reliefs.drawn import bodies
from simulator._reliefs.measured import (
    logarithmic,
    measured_normals,
    random_source,
    rounded,
    scaled_to_slope,
    slope,
    unit,
)
from simulator._reliefs.rugged import crusted, faceted, foliage, patchy, warped, worn

Array = npt.NDArray[np.float64]
Random = np.random.Generator

_PARTS = (crusted, crusted, faceted, worn)
_STREAM = 77
_MARGIN = 8  # the derivatives at the edge are one-sided


def rugged_normals(seed: int, size: int = 240) -> npt.NDArray[np.float32]:
    """Return the normals of a rugged surface as a measurement gives them, as training data.

    One in five is a smooth object with fine detail in some places, and one in ten consists of
    leaves that hide each other. The others are sums of one to three of these: crusts (waves of all
    lengths that are stronger on the longer ones, with ridges or creases), chipped stone, and
    worn surfaces, most of them warped. All are blurred by 0.3 to 1.6 pixels. Their mean slope is 6
    to 42 degrees, and they are tilted by 14 degrees on average. Four in ten contain the errors of
    `random_normals`; three in ten are rounded to 8 bits, and two in ten were stored as JPEG.

    Parameters
    ----------
    seed
        Fixes everything, 0 to 2^63 - 1.
    size
        Side of the square in pixels, 16 to 4096.

    Returns
    -------
    NDArray[np.float32]
        ``(size, size, 3)`` unit vectors in the house frame.

    Raises
    ------
    DataError
        If the size or the seed is out of range.

    Examples
    --------
    >>> import simulator
    >>> simulator.rugged_normals(3, size=64).shape
    (64, 64, 3)
    """
    random = random_source(_STREAM, seed, size)
    normals = measured_normals(random, _relief(random, size + 2 * _MARGIN), faulty=0.4)
    stored = random.random()
    if stored < 0.3:
        normals = rounded(normals)
    elif stored < 0.5:
        normals = _compressed(random, normals)
    return normals[_MARGIN:-_MARGIN, _MARGIN:-_MARGIN].astype(np.float32)


def _relief(random: Random, size: int) -> Array:
    kind = random.integers(10)
    if kind >= 8:
        height = patchy(random, size)
    elif kind == 7:
        height = foliage(random, size)
    else:
        height = np.zeros((size, size))
        for _ in range(random.integers(1, 4)):
            part = _PARTS[random.integers(len(_PARTS))](random, size)
            if random.random() < 0.6:
                part = warped(random, part)
            height += random.uniform(0.2, 1) / slope(gaussian_filter(part, 0.7)) * part
        if random.random() < 0.2:
            height += random.uniform(0.1, 0.6) * bodies(random, size)
    height = gaussian_filter(height, logarithmic(random, 0.3, 1.6), mode="reflect")
    return scaled_to_slope(random, height, 6.0, 42.0)


def _compressed(random: Random, normals: Array) -> Array:
    """Return normals after storage as a JPEG of quality 75 to 98, with all colours or half."""
    image = np.round(127.5 * (normals[..., ::-1] + 1)).clip(0, 255).astype(np.uint8)
    quality = int(random.integers(75, 99))
    colours = (
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        if random.random() < 0.5
        else cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    )
    options = [
        *(cv2.IMWRITE_JPEG_QUALITY, quality),
        *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, colours),
    ]
    stored = cv2.imencode(".jpg", image, options)[1]
    read = cv2.imdecode(stored, cv2.IMREAD_COLOR)
    return unit(np.asarray(read, np.float64)[..., ::-1] / 127.5 - 1)
