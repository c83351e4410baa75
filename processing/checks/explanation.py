"""What explains the images of a recording: its arrangement, single images, or a common cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from acquisition import LINEAR, SRGB, Lights, TransferCurve, angle_deg
from processing.checks import limits
from processing.checks.arrangement import (
    Arrangement,
    better_arrangement,
    residual_of,
    turned_lights,
)
from processing.checks.block_model import BlockModel, Blocks, fit_blocks, light_vectors
from processing.checks.causes import IMAGE_KINDS, KINDS, MOVEMENTS
from processing.checks.contest import Contest, Decision
from processing.checks.derivatives import columns_of, slopes_of
from processing.checks.height_effect import height_effect_mm, mean_height, sparse_blocks
from processing.checks.image_faults import ImageFault, Turned, image_faults
from processing.checks.outline import inward, outward
from processing.checks.shown_lights import ShownLights
from processing.checks.verdict import Cause
from processing.images.viewing_rays import View
from processing.maps.normal_map import NormalMap
from processing.stereo.normals_and_albedo import photometric_stereo
from processing.surface.integrability_test import Integrability, integrability
from rig import figure, listed
from rig.arrays import Float64, Intp

_BLOCKS = 1500
_FEWEST_BLOCKS, _FEWEST_LIGHTS, _FEWEST_IMAGES = 100, 5, 4
# Blocks with less albedo, relative to the bright parts, show nothing.
_DARK = 1e-4
_STEP = 1e-3
_CURVE = "transfer-curve-doubtful"


class Recorded(NamedTuple):
    """Blocks of a recording, and how they were recorded.

    Parameters
    ----------
    blocks
        Blocks of the N images.
    lights
        The N lights.
    strengths
        ``(N,)`` recorded signal of each image, where white is 1, relative to its samples.
    view
        How pixels see the surface under near lights, else None.
    pixel_mm
        Size of a pixel on the object; None if it is not known.
    transfer
        The assumed transfer curve; None if it is known.
    normals
        Robust normals of all cells.
    shape
        Whether they are those of a surface.
    turned
        Returns samples ``(P,)`` of an image whose rows and columns run by these signs.
    detail
        Pixels of the part of the object with most detail, in which movements are sought; None if
        blocks are pixels.
    """

    blocks: Blocks
    lights: Lights
    strengths: Float64
    view: View | None
    pixel_mm: float | None
    transfer: TransferCurve | None
    normals: NormalMap
    shape: Integrability
    turned: Turned
    detail: Blocks | None = None


@dataclass(frozen=True, eq=False)
class Explanation:
    """What explains the images.

    Parameters
    ----------
    causes
        What is probably wrong, by evidence.
    tried
        Names of the causes.
    not_excluded
        Those that would turn normals by more than 1 degree before these images show them.
    least
        Smallest sizes that would be found, with units.
    unexplained
        Share of the squared residual that neither causes nor reflectance explain, 0..1.
    disagreeing
        Images that the others contradict, with the factor of the brightness of those that are only
        too bright or too dark, and None for the others.
    """

    causes: tuple[Cause, ...] = ()
    tried: tuple[str, ...] = ()
    not_excluded: tuple[str, ...] = tuple(KINDS)
    least: dict[str, str] = field(default_factory=dict)
    unexplained: float = 1.0
    disagreeing: dict[str, float | None] = field(default_factory=dict)


def explain(recorded: Recorded, model: BlockModel, shown: ShownLights) -> Explanation:
    """Find what is probably wrong with a recording.

    Another arrangement of the lights explains everything else. Single images that the others do not
    predict are left out, before causes that act on all images compete.

    Parameters
    ----------
    recorded
        The recording.
    model
        The fit of its blocks.
    shown
        The lights that the images show.
    """
    lights = recorded.lights
    if np.count_nonzero(model.valid) < _FEWEST_BLOCKS or len(lights) < _FEWEST_LIGHTS:
        return Explanation()
    other = better_arrangement(model, recorded.blocks.samples, lights)
    curve, residual = _other_curve(recorded, model, limits.BETTER_CURVE)
    if curve is not None and _explained_better(recorded, model, curve.share):
        curve = None
    rim = outward(recorded.normals)
    arranged: Cause | None
    if curve is not None and (other is None or residual < other.residual):
        arranged = curve
    elif (higher := _other_height(recorded, model, other)) is not None:
        arranged = higher
    elif other is not None:
        arranged = _arranged(other, _angle_deg(model, recorded.blocks.fit(other.lights)))
    elif shown.contradict:
        arranged = _unknown_order(shown)
    else:
        # Under near lights, wrong axes leave a residual.
        axes = None if lights.near else _other_axes(model, recorded.shape)
        arranged = axes or inward(rim)
    if arranged is not None:
        # Sizes of others would be those of a wrong arrangement or curve.
        return Explanation((arranged,), (arranged.name,), unexplained=0.0)
    found = image_faults(model, recorded.turned, recorded.blocks.size, recorded.blocks.top)
    causes = list(_of_images(found, recorded))
    wrong = [fault.image for fault in found]
    if wrong:
        model = recorded.blocks.fit(lights, wrong)
    causes += _turned_about_axis(recorded, model, wrong)
    disagreeing: dict[str, float | None] = {lights.ids[i]: None for i in wrong}
    tested = Explanation(tuple(causes), (*IMAGE_KINDS, _CURVE), disagreeing=disagreeing)
    decided = _contest(recorded, recorded.blocks, model)
    if decided is None:
        return tested
    if decided.causes and decided.causes[0].name == _CURVE:
        curve, _ = _other_curve(recorded, model, 1.0)
    if curve is not None:
        return replace(tested, causes=(*causes, curve), unexplained=0.0)
    common, outstanding = decided.causes, decided.outstanding
    if recorded.detail is not None:
        # Blocks of many pixels hardly move.
        model = recorded.detail.fit(lights, wrong)
        fine = _contest(recorded, recorded.detail, model, with_limits=False)
        moved = [] if fine is None else [one for one in fine.causes if one.name in MOVEMENTS]
        if fine is not None and moved:
            common = (*moved, *(one for one in common if one.name not in MOVEMENTS))
            outstanding = {name: gain for name, gain in outstanding.items() if gain is not None}
            outstanding |= {name: None for name, gain in fine.outstanding.items() if gain is None}
    return Explanation(
        (*causes, *common),
        tuple(dict.fromkeys((*tested.tried, *decided.tried))),
        (*decided.not_excluded, *(() if lights.near or rim is not None else ("images-turned",))),
        decided.least,
        decided.unexplained,
        disagreeing | outstanding,
    )


def _contest(
    recorded: Recorded, blocks: Blocks, model: BlockModel, *, with_limits: bool = True
) -> Decision | None:
    """Return what explains the blocks; None if they are too few."""
    slopes = slopes_of(model)
    usable = _usable(model, slopes)
    if len(usable) < _FEWEST_BLOCKS:
        return None
    rays = None if recorded.view is None else recorded.view.rise(blocks.points)
    relative = recorded.strengths / np.exp(np.log(recorded.strengths).mean())
    columns = columns_of(model, recorded.lights, relative, rays, slopes, _toned(recorded, blocks))
    size, pixel_mm = blocks.size, recorded.pixel_mm
    contest = Contest(model, columns, usable, recorded.lights, size, pixel_mm, rays)
    return contest.decide(with_limits=with_limits)


def _toned(recorded: Recorded, blocks: Blocks) -> Callable[[Float64], Float64] | None:
    """Return the derivative of samples by the depth of an S-shaped tone curve of stored values."""
    curve = recorded.transfer
    if curve is None:
        return None
    signal = blocks.scale * recorded.strengths

    def change(radiance: Float64) -> Float64:
        stored = curve.samples(radiance * signal)
        toned = curve.light(stored - _STEP * np.sin(2 * np.pi * stored))
        return np.asarray((toned / signal - radiance) / _STEP)

    return change


def _usable(model: BlockModel, slopes: tuple[Float64, Float64]) -> Intp:
    """Return the blocks that are used; those at the border of the object have no slopes."""
    inside = np.isfinite(slopes[0] + slopes[1]).all(axis=1)
    usable = np.flatnonzero(model.valid & (model.albedo > _DARK) & inside)
    if len(usable) <= _BLOCKS:
        return usable
    return np.sort(np.random.default_rng(0).choice(usable, _BLOCKS, replace=False))


def robust_normals(blocks: Blocks, lights: Lights, kept: Sequence[int]) -> NormalMap:
    """Return the normals of all cells from some images."""
    cells = blocks.cells
    values = cells.values if len(kept) == len(lights) else cells.values[list(kept)]
    return photometric_stereo(
        values, lights.take(list(kept)), cells.mask, method="cauchy", points_mm=cells.points_mm
    ).normal_map


def _arranged(other: Arrangement, effect_deg: float) -> Cause:
    remedy = "turn the images, or the lights" if other.turned else "check the order of the files"
    return Cause(
        other.name, other.text, normals_deg=effect_deg, remedy=remedy, inverts=other.inverts
    )


def _unknown_order(shown: ShownLights) -> Cause:
    text = (
        f"the images fit each other to {shown.consistency:.1%}, but the lights only to "
        f"{shown.residual:.0%} of the signal: the lights are probably in another order than "
        "the images"
    )
    remedy = "check the order of images and lights"
    effect = float(np.median(shown.error_deg))
    return Cause("lights-shuffled", text, normals_deg=effect, remedy=remedy)


def _other_axes(model: BlockModel, shape: Integrability) -> Cause | None:
    """Return the cause if the normals are those of a surface only with other axes."""
    if not _has_other_axes(shape) or _is_turned(shape):
        return None
    how = {
        "mirrored": "mirrored left to right or top to bottom",
        "turned": "turned by 90 degrees",
        "swapped": "with x and y swapped",
    }[shape.axes]
    text = (
        f"the normals are not those of a surface (curl {shape.curl:.2f} of 0 to 1), but with the "
        f"lights or the images {how} they are ({shape.other_curl:.2f})"
    )
    normals = model.normals[model.valid]
    # One of the two horizontal components has the other sign.
    turn = 2 * np.arcsin(np.clip(np.abs(normals[:, :2]), 0, 1))
    effect = float(np.degrees(np.sqrt(np.mean(turn**2))))
    remedy = "check the axes of the lights (x right, y up)"
    return Cause("lights-mirrored", text, normals_deg=effect, remedy=remedy, inverts=True)


def _has_other_axes(shape: Integrability) -> bool:
    return shape.axes != "right" and shape.ratio < limits.AXES


def _is_turned(shape: Integrability) -> bool:
    """Return whether a turn about the line of sight makes the normals those of a surface."""
    size, sigma = abs(shape.turn_deg), shape.turn_sigma_deg
    clear = size > max(limits.TURN_DEG, limits.TURN_SIGMAS * sigma)
    others = shape.other_curl if _has_other_axes(shape) else shape.curl
    return clear and shape.turned_curl < others


def _turned_about_axis(recorded: Recorded, model: BlockModel, wrong: Sequence[int]) -> list[Cause]:
    """Return the cause if all lights are turned about the line of sight.

    The images cannot show it; only the turned normals are not those of a surface.
    """
    shape = recorded.shape
    if wrong:
        kept = [i for i in range(len(recorded.lights)) if i not in wrong]
        others = robust_normals(recorded.blocks, recorded.lights, kept)
        shape = integrability(others.normals, others.mask)
    if not _is_turned(shape):
        return []
    kind, size, sigma = KINDS["lights-turned"], shape.turn_deg, shape.turn_sigma_deg
    back = recorded.blocks.fit(turned_lights(recorded.lights, -size))
    text = kind.text.format(size=f"{figure(size)} +- {figure(sigma, 1)} {kind.unit}")
    effect = _angle_deg(model, back)
    return [Cause("lights-turned", text, size, kind.unit, sigma, effect, remedy=kind.remedy)]


def _of_images(found: Iterable[ImageFault], recorded: Recorded) -> Iterable[Cause]:
    """Yield one cause for each kind of fault, with what happens without these images."""
    ids = recorded.lights.ids
    for name, (noun, remedy) in IMAGE_KINDS.items():
        faults = [fault for fault in found if fault.name == name]
        if not faults:
            continue
        texts = [f"{ids[fault.image]} {fault.text.format(*ids)}" for fault in faults]
        out = [fault.image for fault in faults]
        yield Cause(
            name,
            f"{noun}: {listed(texts)}",
            size=float(len(faults)),
            unit="images",
            sigma=0.0,
            normals_deg=_effect_without(recorded, out),
            remedy=remedy,
            where=", ".join(ids[fault.image] for fault in faults),
        )


def _effect_without(recorded: Recorded, out: Sequence[int]) -> float:
    """Return how much robust normals change without some images: rms, in degrees."""
    kept = [i for i in range(len(recorded.lights)) if i not in out]
    if len(kept) < _FEWEST_IMAGES:
        return float("nan")
    others = robust_normals(recorded.blocks, recorded.lights, kept)
    both = recorded.normals.mask & others.mask
    change = angle_deg(recorded.normals.normals[both], others.normals[both])
    return float(np.sqrt(np.mean(change**2))) if both.any() else float("nan")


def _other_curve(
    recorded: Recorded, model: BlockModel, better: float
) -> tuple[Cause | None, float]:
    """Return the cause if the images agree better with their lights under another transfer curve.

    ``better`` is the residual with the other curve relative to that with the assumed one. The
    residual is returned, too.
    """
    assumed = recorded.transfer
    if assumed is None:
        return None, np.nan
    other = SRGB if assumed == LINEAR else LINEAR
    signal = recorded.blocks.scale * recorded.strengths
    light = other.light(assumed.samples(recorded.blocks.samples * signal)) / signal
    some = sparse_blocks(model)
    rays = None if recorded.view is None else recorded.view.rise(model.points)

    def residual(samples: Float64, curve: TransferCurve) -> float:
        """Return the residual of stored samples at the height at which they fit best."""

        def stored(radiance: Float64) -> Float64:
            return curve.samples(radiance * signal)

        return mean_height(model, some, samples[some], recorded.lights, rays, stored)[1]

    before, after = residual(recorded.blocks.samples, assumed), residual(light, other)
    if after > better * before:
        return None, after
    text = (
        f"read as {assumed.name}, the images deviate from the lights by {before:.1%}, but as "
        f"{other.name} only by {after:.1%}"
    )
    kind = KINDS[_CURVE]
    effect = _angle_deg(model, recorded.blocks.fit(recorded.lights, samples=light))
    height = np.nan
    if recorded.pixel_mm is not None:
        block_mm = recorded.pixel_mm * recorded.blocks.size
        seen = np.where(np.isfinite(light), light, 0.0)[some]
        height = height_effect_mm(model, seen, recorded.lights, rays, block_mm)
    remedy = f"{kind.remedy}: {other.name}"
    share = 1 - (after / before) ** 2
    cause = Cause(_CURVE, text, normals_deg=effect, height_mm=height, remedy=remedy, share=share)
    return cause, after


def _other_height(recorded: Recorded, model: BlockModel, other: Arrangement | None) -> Cause | None:
    """Return the cause if the images agree better with their lights at another mean height.

    It must leave less than another arrangement. Heights that were found on the way from a plane may
    be those of another minimum, or beyond those that were tried.
    """
    if recorded.view is None:
        return None
    some, samples = sparse_blocks(model), recorded.blocks.samples
    before = residual_of(samples[some], model.vectors[some])
    if before < limits.GOOD:
        return None
    rays = recorded.view.rise(model.points)
    rise, after = mean_height(model, some, samples[some], recorded.lights, rays)
    if after > limits.BETTER * before or (other is not None and other.residual < after):
        return None
    text = (
        f"the images deviate from the lights by {before:.1%}, but by {after:.1%} if the object "
        f"is about {abs(rise):.0f} mm {'higher' if rise > 0 else 'lower'}"
    )
    moved = fit_blocks(
        samples.copy(),
        light_vectors(recorded.lights, model.points + rise * rays),
        model.points,
        model.places,
        model.shape,
    )
    remedy = "state its mean height, or that it rests on the working plane"
    return Cause(
        "height-doubtful",
        text,
        size=rise,
        unit="mm",
        normals_deg=_angle_deg(model, moved),
        height_mm=abs(rise),
        remedy=remedy,
    )


def _explained_better(recorded: Recorded, model: BlockModel, share: float) -> bool:
    """Return whether a cause that is no curve explains more than this share of the residual."""
    decided = _contest(recorded, recorded.blocks, model, with_limits=False)
    causes = () if decided is None else decided.causes
    return bool(causes) and causes[0].name != _CURVE and causes[0].share > share


def _angle_deg(one: BlockModel, other: BlockModel) -> float:
    both = one.valid & other.valid
    sine = np.linalg.norm(np.cross(one.normals[both], other.normals[both]), axis=1)
    cosine = (one.normals[both] * other.normals[both]).sum(axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.arctan2(sine, cosine) ** 2))))
