"""Blocks of pixels of matte surfaces: their mean values, points and normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition import Lights
from calibration._errors import EstimateError
from calibration.intensities.surface import MatteSurface
from rig import pluralize
from rig.arrays import Bool, Float32, Float64, Generic, Intp

# Few enough for speed; small surfaces are not averaged.
_BLOCKS = 3000
_FEWEST = 100
# Pixels below this share of the brightness of the brightest ones show no card.
_DARK = 0.01
# Cosine at the surface below which light grazes it, and roughness and shadows count most.
_GRAZING = 0.05
_CHANNELS = ("red", "green", "blue")


@dataclass(frozen=True, eq=False)
class Blocks:
    """P blocks of pixels of all surfaces under K lights in C channels.

    Parameters
    ----------
    values
        ``(C, K, P)`` mean values; NaN where a sample is missing.
    points_mm, normals
        ``(P, 3)``.
    radius
        ``(P,)`` distance from the middle of the image, relative to its corner.
    part
        ``(P,)`` index of the surface.
    pixels
        Number of pixels in all blocks.
    upward
        ``(P, 3)`` displacements of the seen points if the surfaces are 1 mm higher.
    cards
        Whether all surfaces are cards, parallel to the working plane.
    """

    values: Float64
    points_mm: Float64
    normals: Float64
    radius: Float64
    part: Intp
    pixels: int
    upward: Float64
    cards: bool


def blocks_of(surfaces: Sequence[MatteSurface], lights: Lights) -> Blocks:
    """Average surfaces over blocks, and leave out those that too few lights reach.

    Raises
    ------
    EstimateError
        If too few blocks remain; the message names the light or the channel.
    """
    parts = [_blocks_of(surface, lights, i, len(surfaces)) for i, surface in enumerate(surfaces)]
    values = np.concatenate([part.values for part in parts], axis=2)
    of_blocks = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("points_mm", "normals", "radius", "part", "upward")
    }
    pixels, cards = sum(part.pixels for part in parts), all(part.cards for part in parts)
    joined = Blocks(values=values, pixels=pixels, cards=cards, **of_blocks)
    per_light = np.isfinite(values).all(axis=0).sum(axis=1)
    if per_light.min() < _FEWEST:
        worst = lights.ids[int(per_light.argmin())]
        raise EstimateError(
            f"light {worst} lights only {pluralize(int(per_light.min()), 'unsaturated pixel')} of "
            f"the card, at least {_FEWEST} are required: check the LED, the exposure and the mask"
        )
    return joined


def _blocks_of(surface: MatteSurface, lights: Lights, index: int, count: int) -> Blocks:
    height, width = surface.mask.shape
    points, normals_of = surface.points_mm, np.asarray(surface.normals)
    usable = surface.mask & np.isfinite(points).all(axis=2) & np.isfinite(normals_of).all(axis=2)
    usable &= _lit(surface.values, usable)
    found = int(usable.sum())
    if found < _FEWEST:
        raise EstimateError(
            f"{pluralize(found, 'pixel of the plane is', 'pixels of the plane are')} lit and "
            f"unsaturated under two or more lights, at least {_FEWEST} are required: check the "
            "exposure and the mask"
        )
    side = int(np.ceil(np.sqrt(found * count / _BLOCKS))) if found * count > 2 * _BLOCKS else 1
    side = min(side, max(1, int(np.sqrt(found / _FEWEST))))
    share = means_of_blocks(usable.astype(np.float64), side)
    rows, columns = np.nonzero(share == 1.0)
    radius = np.hypot(rows * side + (side - height) / 2, columns * side + (side - width) / 2)
    values = np.stack([means_of_blocks(image, side)[rows, columns] for image in surface.values])
    values = np.moveaxis(values[..., None] if values.ndim == 2 else values, -1, 0)
    where = means_of_blocks(points, side)[rows, columns]
    normals = means_of_blocks(normals_of, side)[rows, columns]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        values = np.where(values > 0, values, np.nan)
    facing, ahead = _cosines(lights, where, normals)
    reach = (facing > _GRAZING) & (ahead > _GRAZING)
    few = np.count_nonzero(reach, axis=1)
    if few.min() < min(_FEWEST, len(where)) and count == 1:
        raise EstimateError(
            f"light {lights.ids[int(few.argmin())]} cannot reach the lit pixels of its image from "
            "its position: check its position and axis, and the camera"
        )
    values = np.where(reach, values, np.nan)
    _check_channels(values)
    # A pixel whose albedo is free says something about the lights only if two of them reach it.
    keep = (np.isfinite(values).sum(axis=1) >= 2).all(axis=0)
    up = np.array([0.0, 0.0, 1.0])
    upward = np.broadcast_to(up, where.shape)
    if surface.camera_mm is not None:
        toward = surface.camera_mm - where
        upward = toward / toward[:, 2:]
    return Blocks(
        values[:, :, keep],
        where[keep],
        normals[keep],
        radius[keep] / np.hypot(height / 2, width / 2),
        np.full(int(keep.sum()), index),
        int(keep.sum()) * side**2,
        upward[keep],
        bool(np.all(normals == up)),
    )


def _lit(values: Float32, usable: Bool) -> Bool:
    """Return the pixels that two or more lights light, and that are not far darker than others."""
    lit = np.zeros(usable.shape, np.int64)
    total = np.zeros(usable.shape)
    for image in values:
        gray = image if image.ndim == 2 else image.sum(axis=2)
        with np.errstate(invalid="ignore"):
            shown = (image > 0) if image.ndim == 2 else (image > 0).any(axis=2)
        lit += shown
        total += np.where(np.isfinite(gray), gray, 0.0)
    mean = total / np.maximum(lit, 1)
    shows = usable & (lit >= 2)
    if shows.any():
        shows &= mean > _DARK * np.percentile(mean[shows], 95)
    return shows


def _cosines(lights: Lights, points: Float64, normals: Float64) -> tuple[Float64, Float64]:
    """Return the cosines ``(K, P)`` at the surface and at the light."""
    toward = np.asarray(lights.positions_mm)[:, None] - points
    toward /= np.linalg.norm(toward, axis=2, keepdims=True)
    facing: Float64 = np.sum(toward * normals, axis=2)
    ahead: Float64 = -np.einsum("kpi,ki->kp", toward, np.asarray(lights.axes))
    return facing, ahead


def _check_channels(values: Float64) -> None:
    for name, channel in zip(_CHANNELS, values, strict=False):
        if len(values) == 3 and not np.isfinite(channel).any():
            raise EstimateError(
                f"the {name} channel shows no light: use gray images, or repair the channel"
            )


def means_of_blocks(image: Generic, side: int) -> Float64:
    """Return the means of ``side x side`` pixels; NaN if one of them is NaN."""
    rows, columns = image.shape[0] // side, image.shape[1] // side
    whole = image[: rows * side, : columns * side]
    shape = (rows, side, columns, side, *image.shape[2:])
    return np.asarray(whole.reshape(shape).mean(axis=(1, 3), dtype=np.float64))
