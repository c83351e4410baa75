"""Faults of image files: copies of another image, and images that are turned."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from processing._reconstruction.cells import Samples
from processing._reconstruction.recorded_images import Images
from processing._reconstruction.self_calibration import Factors, angles_deg, solve
from rig import Notice, pluralize

Double = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_FEWEST_PIXELS = 100
# A relative difference below this is rounding: noise makes frames differ.
_IDENTICAL = 1e-8
# What three components leave of one image, as a fraction of a sample and of the typical image:
# enough to try whether it is turned, and as much as a wrong brightness of a quarter leaves.
_DOUBTFUL = 0.06
_TYPICAL = 4.0
# A turned copy of an image must fit the others this much better.
_BETTER = 0.5
_TURNS: dict[str, tuple[int, int]] = {
    "upside down": (-1, -1),
    "mirrored left to right": (1, -1),
    "mirrored top to bottom": (-1, 1),
}
_LISTED = 4


def duplicates(samples: Samples, ids: Sequence[str]) -> list[Notice]:
    """Return a warning about images that are equal but for a factor, under different lights."""
    everywhere = samples.usable.all(axis=1)
    if np.count_nonzero(everywhere) < _FEWEST_PIXELS:
        return []
    radiance = samples.values[everywhere] / samples.scale[everywhere]
    unit = radiance / np.linalg.norm(radiance, axis=0)
    first, second = np.nonzero(np.triu(1 - unit.T @ unit < _IDENTICAL, 1))
    apart = angles_deg(samples.vectors[first], samples.vectors[second]) > 1
    pairs = [(int(i), int(j)) for i, j in zip(first[apart], second[apart], strict=True)]
    several = {i for pair in pairs for i in pair}
    # Images of a plane under distant lights are all equal.
    if not pairs or len(several) > max(len(ids) / 2, 2):
        return []
    texts = [f"{ids[i]} and {ids[j]}" for i, j in pairs[:_LISTED]]
    text = (
        f"the images of {', '.join(texts)} are the same image: one of them is missing; restore it, "
        "or leave the copy out"
    )
    return [Notice("image-duplicate", text, ", ".join(ids[i] for i in sorted(several)))]


def turned_images(
    factors: Factors, samples: Samples, images: Images, mask: Mask, suspects: Iterable[int]
) -> dict[int, str]:
    """Return the images that fit the others much better if they are turned, and how.

    Parameters
    ----------
    factors
        Lights and normals that the N images show.
    samples
        The samples from which these follow.
    images
        ``(N, H, W)`` linear radiance, from which single images are read again.
    mask
        ``(H, W)`` bool, the object.
    suspects
        Images that disagree with the others; those that three components hardly explain are tried
        as well.
    """
    left = np.array(
        [
            float(np.median(np.abs(deviation[usable]))) if usable.any() else 0.0
            for deviation, usable in zip(factors.deviation.T, samples.usable.T, strict=True)
        ]
    )
    doubtful = left > max(_DOUBTFUL, _TYPICAL * float(np.median(left)))
    tried = sorted({*suspects, *(int(i) for i in np.flatnonzero(doubtful))})
    found = {i: _turned(i, factors, samples, images, mask) for i in tried}
    return {i: how for i, how in found.items() if how is not None}


def turned_notice(turned: dict[int, str], ids: Sequence[str]) -> Notice:
    """Return the warning about images that are turned."""
    names = ", ".join(f"{ids[i]} ({how})" for i, how in list(turned.items())[:_LISTED])
    more = f" and {len(turned) - _LISTED} more" if len(turned) > _LISTED else ""
    noun = pluralize(len(turned), "image is", "images are")
    text = f"{noun} not in the position of the others: {names}{more}; turn the file"
    return Notice("image-turned", text, ", ".join(ids[i] for i in turned))


def _turned(i: int, factors: Factors, samples: Samples, images: Images, mask: Mask) -> str | None:
    """Return how an image must be turned to fit the others; None if that does not help."""
    image = images[i]
    size = np.array(mask.shape)
    left = {}
    for name, signs in {"as it is": (1, 1), **_TURNS}.items():
        places = np.where(np.array(signs) < 0, size - 1 - samples.pixels, samples.pixels)
        rows, columns = places.T
        values = image[rows, columns] * samples.scale[:, i]
        usable = mask[rows, columns] & np.isfinite(values) & (values > 0)
        if np.count_nonzero(usable) < _FEWEST_PIXELS:
            return None
        left[name] = _left(np.where(usable, values, 0.0), usable, factors.normals)
    best = min(left, key=lambda name: left[name])
    return best if left[best] < _BETTER * left["as it is"] else None


def _left(values: Double, usable: Mask, normals: Double) -> float:
    """Return the median deviation of one image from a linear function of the normals."""
    weight = usable.astype(np.float64)
    for _ in range(8):
        light = solve(weight[None], values[None], normals)[0]
        deviation = np.abs(values - normals @ light)
        typical = float(np.median(deviation[usable]))
        weight = usable / (1 + (deviation / max(2 * typical, 1e-6)) ** 2)
    return typical / max(float(np.median(values[usable])), 1e-12)
