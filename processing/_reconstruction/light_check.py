"""Comparison of each image's light with the light that the images themselves show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from processing._reconstruction.recorded_images import Images
from processing._reconstruction.samples import Samples
from processing._reconstruction.self_calibration import (
    Factors,
    align,
    angles_deg,
    explained,
    factorise,
    solve,
)
from processing._reconstruction.under_lights import relative_residual
from rig import Notice, pluralize, short_repr

Double = npt.NDArray[np.float64]
Float = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

# With fewer images, three of them determine the map between found and given lights, and the others
# hardly check it.
_FEWEST_CHECKED = 8
_FEWEST_IMAGES = 5
_FEWEST_PIXELS = 100
# The third component of the images, as a fraction of a sample: .05 is a relief whose normals
# vary by about 8 degrees. Flatter objects do not show where the lights are; a wrong falloff of near
# lights alone reaches .02.
_LEAST_RELIEF = 0.04
# The same component relative to what three components do not explain.
_LEAST_CLEAR = 1.0
# Two thirds of the lights must be closer than this to those that the images show. Simulated
# correct recordings reach 5 degrees (a sphere in near light), shuffled ones 22 and more.
_SHUFFLED_DEG = 12.0
# A shuffled order leaves more than a tenth of the signal unexplained; any order that explains the
# images as well as they explain each other is not wrong.
_SHUFFLED_RESIDUAL = 0.1
_SHUFFLED_FACTOR = 1.5
# With fewer images than can be checked one by one, the residuals must differ by more.
_FEW_RESIDUAL = 0.15
_FEW_FACTOR = 2.5
# One light: half of this error, in one of 12 images, changes normals by less than a degree.
_MOVED_DEG = 12.0
_MOVED_FACTOR = 5.0
_GAIN = 0.3
_GAIN_FACTOR = 5.0
# Gloss and shadows, which three components do not explain, change the brightness of single images.
_GAIN_GLOSS = 4.0
# What three components leave of one image, as a fraction of a sample and of the typical image:
# enough to try whether it is turned, and as much as a wrong brightness of a quarter leaves.
_DOUBTFUL = 0.06
_ALIEN = 0.2
_ALIEN_FACTOR = 4.0
# A turned copy of an image must fit the others this much better.
_TURNED_FACTOR = 0.5
_NAMED_DEG = 6.0
# Two lights are exchanged if each image shows the place of the other light, and the places are
# distinct: by this angle, and by this multiple of the median error. An error of that size in
# opposite directions is improbable; none of 240 random objects has such a pair.
_EXCHANGED_DEG = 4.0
_EXCHANGED_FACTOR = 4.0
# A relative difference below this is rounding: noise makes frames differ.
_IDENTICAL = 1e-8
_LISTED = 4


@dataclass(frozen=True, eq=False)
class LightCheck:
    """What the images show about their lights.

    Parameters
    ----------
    consistency
        Median relative residual of the images as linear combinations of three; NaN without enough
        pixels.
    error_deg, gain
        ``(N,)`` angle between the given light and the one that the images show, and the brightness
        of the image relative to that light; NaN if the images do not determine it.
    warnings
        The likely causes.
    """

    consistency: float
    error_deg: Double
    gain: Double
    warnings: tuple[Notice, ...]

    __repr__ = short_repr


def check_lights(
    samples: Samples,
    residual: float,
    ids: Sequence[str],
    images: Images,
    mask: Mask,
) -> LightCheck:
    """Compare the given lights with those that the images show.

    Parameters
    ----------
    samples
        Samples of the N images.
    residual
        Median relative residual of the images under the given lights.
    ids
        Names of the lights.
    images
        ``(N, H, W)`` linear radiance, from which single images are read again.
    mask
        ``(H, W)`` bool, the object.
    """
    count = len(ids)
    unknown = np.full(count, np.nan)
    if count < _FEWEST_IMAGES or len(samples.values) < _FEWEST_PIXELS:
        return LightCheck(float("nan"), unknown, unknown, ())
    factors = factorise(samples.values, samples.usable)
    consistency = relative_residual(factors.deviation, samples.usable)
    weakest = factors.strengths[2]
    if weakest < max(_LEAST_RELIEF, _LEAST_CLEAR * consistency):
        return LightCheck(consistency, unknown, unknown, ())
    if count < _FEWEST_CHECKED:
        if residual > max(_FEW_RESIDUAL, _FEW_FACTOR * consistency):
            return LightCheck(consistency, unknown, unknown, (shuffled(residual, consistency),))
        return LightCheck(consistency, unknown, unknown, ())
    given = samples.vectors
    mapped = align(factors.lights, given)
    error = angles_deg(mapped, given)
    gain = np.linalg.norm(mapped, axis=1) / np.linalg.norm(given, axis=1)
    if np.quantile(error, 2 / 3) > _SHUFFLED_DEG and residual > max(
        _SHUFFLED_RESIDUAL, _SHUFFLED_FACTOR * consistency
    ):
        return LightCheck(consistency, error, gain, (shuffled(residual, consistency),))
    if not explained(mapped, given):
        return LightCheck(consistency, unknown, unknown, ())
    doubtful, alien = _aliens(factors, samples)
    wrong = _far(error) | _odd(gain, consistency) | alien
    tried = np.flatnonzero(wrong | doubtful)
    turned = {int(i): _turned(int(i), factors, samples, images, mask) for i in tried}
    pairs = _exchanged(mapped, given, error)
    suspects = [i for i, how in turned.items() if wrong[i] or how is not None]
    suspects = sorted({*suspects, *pairs})
    warnings = _named(suspects, turned, pairs, error, gain, alien, mapped, given, ids)
    return LightCheck(consistency, error, gain, tuple(warnings))


def shuffled(residual: float, consistency: float) -> Notice:
    """Return the warning about lights in another order."""
    text = (
        f"the images fit each other to {consistency:.1%}, but the lights only to {residual:.0%} of "
        "the signal: the lights are probably in another order than the images"
    )
    return Notice("lights-shuffled", text)


def duplicates(samples: Samples, ids: Sequence[str]) -> list[Notice]:
    """Return a warning about images that are equal but for a factor, under different lights."""
    count = len(ids)
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
    if not pairs or len(several) > max(count / 2, 2):
        return []
    texts = [f"{ids[i]} and {ids[j]}" for i, j in pairs[:_LISTED]]
    text = (
        f"the images of {', '.join(texts)} are the same image: one of them is missing; restore it, "
        "or leave the copy out"
    )
    return [Notice("image-duplicate", text, ", ".join(ids[i] for i in sorted(several)))]


def _far(error: Double) -> Mask:
    """Return the lights that are far from those that the images show."""
    far: Mask = error > max(_MOVED_DEG, _MOVED_FACTOR * float(np.median(error)))
    return far


def _exchanged(mapped: Double, given: Double, error: Double) -> dict[int, int]:
    """Return the lights whose images show the places of one another, each with the other one."""
    apart = angles_deg(given[:, None], given[None])
    shown = angles_deg(mapped[:, None], given[None])
    limit = max(_EXCHANGED_DEG, _EXCHANGED_FACTOR * float(np.median(error)))
    other = (2 * shown < apart) & (apart > limit)
    first, second = np.nonzero(other & other.T)
    return {int(i): int(j) for i, j in zip(first, second, strict=True)}


def _odd(gain: Double, consistency: float) -> Mask:
    """Return the lights whose images are too bright or too dark."""
    logarithm = np.log(np.maximum(gain, 1e-6) / np.median(gain))
    spread = float(np.median(np.abs(logarithm)))
    limit = max(float(np.log(1 + _GAIN)), _GAIN_FACTOR * spread, _GAIN_GLOSS * consistency)
    odd: Mask = np.abs(logarithm) > limit
    return odd


def _aliens(factors: Factors, samples: Samples) -> tuple[Mask, Mask]:
    """Return the images that are not quite, and not at all, linear combinations of the others."""
    left = np.array(
        [
            float(np.median(np.abs(deviation[usable]))) if usable.any() else 0.0
            for deviation, usable in zip(factors.deviation.T, samples.usable.T, strict=True)
        ]
    )
    typical = _ALIEN_FACTOR * float(np.median(left))
    return left > max(_DOUBTFUL, typical), left > max(_ALIEN, typical)


_TURNS: dict[str, tuple[int, int]] = {
    "upside down": (-1, -1),
    "mirrored left to right": (1, -1),
    "mirrored top to bottom": (-1, 1),
}


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
    return best if left[best] < _TURNED_FACTOR * left["as it is"] else None


def _left(values: Double, usable: Mask, normals: Double) -> float:
    """Return the median deviation of one image from a linear function of the normals."""
    weight = usable.astype(np.float64)
    for _ in range(8):
        light = solve(weight[None], values[None], normals)[0]
        deviation = np.abs(values - normals @ light)
        typical = float(np.median(deviation[usable]))
        weight = usable / (1 + (deviation / max(2 * typical, 1e-6)) ** 2)
    return typical / max(float(np.median(values[usable])), 1e-12)


def _named(
    suspects: list[int],
    turned: dict[int, str | None],
    pairs: dict[int, int],
    error: Double,
    gain: Double,
    alien: Mask,
    mapped: Double,
    given: Double,
    ids: Sequence[str],
) -> list[Notice]:
    """Return one warning for each kind of fault, with the names of the images."""
    far = _far(error)
    found: dict[str, list[tuple[int, str]]] = {}

    def add(code: str, i: int, text: str) -> None:
        found.setdefault(code, []).append((i, f"{ids[i]} {text}".strip()))

    for i in suspects:
        angles = angles_deg(np.broadcast_to(mapped[i], given.shape), given)
        nearest = int(np.argmin(angles))
        if turned.get(i) is not None:
            add("turned", i, f"({turned[i]})")
        elif i in pairs:
            add("other", i, f"(it shows the light of {ids[pairs[i]]})")
        elif far[i] and nearest != i and angles[nearest] < _NAMED_DEG:
            add("other", i, f"(it shows the light of {ids[nearest]})")
        elif alien[i]:
            add("alien", i, "")
        elif far[i]:
            add("moved", i, f"(by {error[i]:.0f} degrees)")
        else:
            add("bright", i, f"({gain[i] / np.median(gain):.2f} times)")
    return list(_notices(found, ids))


_CODES: dict[str, str] = {
    "turned": "image-turned",
    "other": "images-swapped",
    "alien": "image-disagrees",
    "moved": "light-moved",
    "bright": "light-brightness",
}
# What is wrong with one and with several, and the remedy.
_TEXTS = {
    "turned": (
        "image is not in the position of the others",
        "images are not in the position of the others",
        "turn the file",
    ),
    "other": (
        "image belongs to another light",
        "images belong to another light",
        "check the order of images and lights",
    ),
    "alien": (
        "image does not fit the others under any light",
        "images do not fit the others under any light",
        "it may show another moment, other exposure, or stray light",
    ),
    "moved": (
        "light is not where the images show it",
        "lights are not where the images show them",
        "did a lamp move, or is the image turned?",
    ),
    "bright": (
        "image is brighter or darker than the light explains",
        "images are brighter or darker than the light explains",
        "check intensities and exposure times",
    ),
}


def _notices(found: dict[str, list[tuple[int, str]]], ids: Sequence[str]) -> Iterator[Notice]:
    for kind, (one, several, remedy) in _TEXTS.items():
        if not (rows := found.get(kind)):
            continue
        names = ", ".join(text for _, text in rows[:_LISTED])
        more = f" and {len(rows) - _LISTED} more" if len(rows) > _LISTED else ""
        where = ", ".join(ids[i] for i, _ in rows) if len(rows) <= _LISTED else ""
        text = f"{pluralize(len(rows), one, several)}: {names}{more}; {remedy}"
        yield Notice(_CODES[kind], text, where)
