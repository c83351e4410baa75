"""How well images, lights and normals of a recording agree, and what probably does not."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from acquisition import DataError, Lights
from processing.checks.light_fit import Fit, Remedy, fit, relative_residual, remedy
from processing.checks.scheme_check import SchemeCheck, check_scheme, scheme_notices
from processing.checks.self_calibration import (
    Factors,
    align,
    angles_deg,
    explained,
    factorise,
    solve,
)
from processing.images.block_means import Cells, Samples, cells_of, samples_of
from processing.images.recorded_images import Images
from processing.images.viewing_rays import SurfacePoints
from processing.stereo.normals_and_albedo import photometric_stereo
from processing.surface.integrability_test import Integrability, integrability
from rig import Notice, pluralize, short_repr
from rig.arrays import Bool, Float64

_TURNS: dict[str, tuple[int, int]] = {
    "upside down": (-1, -1),
    "mirrored left to right": (1, -1),
    "mirrored top to bottom": (-1, 1),
}

_FEWEST_PIXELS = 100
# A relative difference below this is rounding: noise makes frames differ.
_IDENTICAL = 1e-8
# What three components leave of one image, as a fraction of a sample and of the typical image:
# enough to try whether it is turned, and as much as a wrong brightness of a quarter leaves.
_DOUBTFUL = 0.06
_TYPICAL = 4.0
# A turned copy of an image must fit the others this much better.
_BETTER = 0.5
_LISTED = 4
# With fewer images, three of them determine the map between found and given lights, and the others
# hardly check it.
_FEWEST_CHECKED = 8
_FEWEST_IMAGES = 5
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


def _duplicates(samples: Samples, ids: Sequence[str]) -> list[Notice]:
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


def _turned_images(
    factors: Factors, samples: Samples, images: Images, mask: Bool, suspects: Iterable[int]
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


def _turned_notice(turned: dict[int, str], ids: Sequence[str]) -> Notice:
    """Return the warning about images that are turned."""
    names = ", ".join(f"{ids[i]} ({how})" for i, how in list(turned.items())[:_LISTED])
    more = f" and {len(turned) - _LISTED} more" if len(turned) > _LISTED else ""
    noun = pluralize(len(turned), "image is", "images are")
    text = f"{noun} not in the position of the others: {names}{more}; turn the file"
    return Notice("image-turned", text, ", ".join(ids[i] for i in turned))


def _turned(i: int, factors: Factors, samples: Samples, images: Images, mask: Bool) -> str | None:
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


def _left(values: Float64, usable: Bool, normals: Float64) -> float:
    """Return the median deviation of one image from a linear function of the normals."""
    weight = usable.astype(np.float64)
    for _ in range(8):
        light = solve(weight[None], values[None], normals)[0]
        deviation = np.abs(values - normals @ light)
        typical = float(np.median(deviation[usable]))
        weight = usable / (1 + (deviation / max(2 * typical, 1e-6)) ** 2)
    return typical / max(float(np.median(values[usable])), 1e-12)


class _LightCheck(NamedTuple):
    """What the images show about their lights.

    Parameters
    ----------
    consistency
        Median relative residual of the images as linear combinations of three; NaN without enough
        pixels.
    error_deg, gain
        ``(N,)`` angle between the given light and the one that the images show, and the brightness
        of the image relative to that light; NaN if the images do not determine it.
    factors
        Lights and normals that the images show; None if they do not follow the given lights.
    shuffled
        A warning if the lights are in another order.
    """

    consistency: float
    error_deg: Float64
    gain: Float64
    factors: Factors | None = None
    shuffled: Notice | None = None


def _check_lights(samples: Samples, residual: float) -> _LightCheck:
    """Compare the given lights of all images with those that the images show.

    Parameters
    ----------
    samples
        Samples of the N images.
    residual
        Median relative residual of the images under the given lights.
    """
    count = len(samples.vectors)
    unknown = np.full(count, np.nan)
    if count < _FEWEST_IMAGES or len(samples.values) < _FEWEST_PIXELS:
        return _LightCheck(float("nan"), unknown, unknown)
    factors = factorise(samples.values, samples.usable)
    consistency = relative_residual(factors.deviation, samples.usable)
    weakest = factors.strengths[2]
    if weakest < max(_LEAST_RELIEF, _LEAST_CLEAR * consistency):
        return _LightCheck(consistency, unknown, unknown)
    if count < _FEWEST_CHECKED:
        few = residual > max(_FEW_RESIDUAL, _FEW_FACTOR * consistency)
        warning = _shuffled(residual, consistency) if few else None
        return _LightCheck(consistency, unknown, unknown, shuffled=warning)
    given = samples.vectors
    mapped = align(factors.lights, given)
    error = angles_deg(mapped, given)
    gain = np.linalg.norm(mapped, axis=1) / np.linalg.norm(given, axis=1)
    limit = max(_SHUFFLED_RESIDUAL, _SHUFFLED_FACTOR * consistency)
    if np.quantile(error, 2 / 3) > _SHUFFLED_DEG and residual > limit:
        return _LightCheck(consistency, error, gain, shuffled=_shuffled(residual, consistency))
    if not explained(mapped, given):
        return _LightCheck(consistency, unknown, unknown)
    return _LightCheck(consistency, error, gain, factors)


def _shuffled(residual: float, consistency: float) -> Notice:
    text = (
        f"the images fit each other to {consistency:.1%}, but the lights only to {residual:.0%} of "
        "the signal: the lights are probably in another order than the images"
    )
    return Notice("lights-shuffled", text)


@dataclass(frozen=True, eq=False)
class ImageQuality:
    """Agreement of the images of an object with their lights and with each other.

    Parameters
    ----------
    residual
        Median over the object of the rms deviation of the samples from a matte surface under the
        lights, relative to the signal, 0..1. Samples in shadow do not count.
    consistency
        The same for the best three images whose combinations are all others, whatever the lights;
        NaN if there are fewer than four images.
    used
        Share 0..1 of the samples of the object that are neither saturated nor in shadow.
    image_residual
        ``(N,)`` median absolute deviation of each image from the lights, relative to the signal.
    light_error_deg
        ``(N,)`` angle between each light and the light that its image shows, compared with the
        other images; NaN with fewer than 8 images, or if the object is too flat to show it. A
        common rotation or reflection of all lights cannot be seen.
    light_gain
        ``(N,)`` brightness of each image relative to its light, NaN in the same cases.
    curl
        Disagreement of the mixed derivatives of the normals, see `integrability`: 0 for a surface,
        1 for a mirrored one, about .7 for noise; NaN with too few pixels.
    scheme
        Comparison of each image with what the other images predict.
    ids
        Names of the N lights.
    warnings
        The likely causes of disagreement beyond the limits that docs/quality.md states.
    """

    residual: float
    consistency: float
    used: float
    image_residual: Float64
    light_error_deg: Float64
    light_gain: Float64
    curl: float
    scheme: SchemeCheck = field(repr=False)
    ids: tuple[str, ...]
    warnings: tuple[Notice, ...]

    __repr__ = short_repr


def image_quality(
    values: Images,
    lights: Lights,
    mask: Bool,
    *,
    points_mm: Float64 | None = None,
) -> ImageQuality:
    """Test whether images, lights and the normals that follow from them agree.

    The tests use means over about 16,000 cells of the object, so that their cost does not grow
    with the size of the images apart from one pass over them.

    Parameters
    ----------
    values
        ``(N, H, W)`` float32 linear radiance under lights of intensity 1, NaN where saturated.
    lights
        The N lights.
    mask
        ``(H, W)`` bool, the object.
    points_mm
        ``(H, W, 3)`` surface points for lights with positions, as for `photometric_stereo`.

    Returns
    -------
    ImageQuality
        Figures and warnings.

    Raises
    ------
    DataError, EstimateError
        As `photometric_stereo`.

    Examples
    --------
    >>> import numpy as np
    >>> from acquisition import Lights
    >>> from processing.checks import image_quality
    >>> around = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    >>> lights = Lights(directions=np.stack([np.cos(around), np.sin(around), 0 * around + 2], 1))
    >>> y, x = np.mgrid[0.7:-0.7:48j, -0.7:0.7:48j]
    >>> normals = np.dstack([x, y, np.sqrt(1 - x**2 - y**2)])
    >>> values = np.einsum("nk,hwk->nhw", lights.unit_directions, normals).clip(0)
    >>> image_quality(values.astype(np.float32), lights, np.ones((48, 48), bool)).warnings
    ()
    """
    if not mask.any():
        raise DataError("the mask is empty: there is no pixel to compute")
    return quality_of(values, lights, mask, points_mm)


def quality_of(
    values: Images,
    lights: Lights,
    mask: Bool,
    points_mm: Float64 | SurfacePoints | None,
) -> ImageQuality:
    """Return `image_quality` with surface points of any form."""
    cells = cells_of(values, mask, points_mm)
    if not cells.mask.any():
        unknown = np.full(len(lights), np.nan)
        return ImageQuality(
            np.nan, np.nan, np.nan, unknown, unknown, unknown, np.nan,
            SchemeCheck((), False, False), lights.ids, (),
        )  # fmt: skip
    samples = samples_of(cells, lights)
    found = fit(samples)
    check = _check_lights(samples, found.residual)
    normals = photometric_stereo(
        cells.values, lights, cells.mask, method="cauchy", points_mm=cells.points_mm
    ).normal_map
    shape = integrability(normals.normals, normals.mask)
    scheme = check_scheme(cells, lights)
    turned: dict[int, str] = {}
    if check.factors is not None:
        suspects = (one.image for one in scheme.found)
        turned = _turned_images(check.factors, samples, values, mask, suspects)
    return ImageQuality(
        residual=found.residual,
        consistency=check.consistency,
        used=samples.share,
        image_residual=found.per_image,
        light_error_deg=check.error_deg,
        light_gain=check.gain,
        curl=shape.curl,
        scheme=scheme,
        ids=lights.ids,
        warnings=_likely(cells, lights, samples, found, check, turned, shape, scheme),
    )


def _likely(
    cells: Cells,
    lights: Lights,
    samples: Samples,
    found: Fit,
    check: _LightCheck,
    turned: dict[int, str],
    shape: Integrability,
    scheme: SchemeCheck,
) -> tuple[Notice, ...]:
    """Return the warnings of the most likely cause; one mistake disturbs the other tests."""
    copies = _duplicates(samples, lights.ids)
    if copies:
        return tuple(copies)
    change = remedy(cells, lights, found)
    if change is not None and not change.images:
        return (_remedy_warning(change, found, lights.ids),)
    if check.shuffled is not None:
        return (check.shuffled,)
    others = tuple(one for one in scheme.found if one.image not in turned)
    singles = scheme_notices(replace(scheme, found=others), lights.ids)
    if turned:
        singles.insert(0, _turned_notice(turned, lights.ids))
    if singles:
        return tuple(singles)
    if change is not None:
        return (_remedy_warning(change, found, lights.ids),)
    return _axes_warning(shape)


def _remedy_warning(change: Remedy, found: Fit, ids: tuple[str, ...]) -> Notice:
    names = [ids[i] for i in change.images]
    before, after = f"{found.residual:.1%} of the signal", f"{change.residual:.1%}"
    if len(names) == 2:
        text = (
            f"the images of {names[0]} and {names[1]} are probably swapped: the images deviate "
            f"from the lights by {before}, and by {after} if the two are exchanged; check the "
            "order of images and lights"
        )
        return Notice("images-swapped", text, ", ".join(names))
    if names:
        text = (
            f"the image of {names[0]} does not fit the others: the images deviate from the lights "
            f"by {before}, and by {after} without it; it may be turned, show another moment, or "
            "its lamp may have moved or changed"
        )
        return Notice("image-disagrees", text, names[0])
    text = (
        "the lights are probably in another order than the images: the images deviate from the "
        f"lights by {before}, and by {after} {change.name}"
    )
    return Notice("lights-shuffled", text)


def _axes_warning(shape: Integrability) -> tuple[Notice, ...]:
    if shape.axes == "right":
        return ()
    cause = {
        "mirrored": "mirrored left to right or top to bottom",
        "turned": "turned by 90 degrees",
        "swapped": "with x and y swapped",
    }[shape.axes]
    text = (
        f"the normals are not those of a surface (curl {shape.curl:.2f} of 0 to 1), but with the "
        f"lights or the images {cause} they are ({shape.other_curl:.2f}): check the axes of the "
        "lights (x right, y up); a turn by 180 degrees cannot be seen"
    )
    return (Notice("lights-mirrored", text),)
