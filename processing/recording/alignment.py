"""Alignment of the images of a recording whose camera or object moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, Literal, NamedTuple

import numpy as np

from acquisition import Lights, angle_deg
from calibration import EstimateError
from processing.images.recorded_images import RecordedImages
from processing.images.viewing_rays import View
from processing.registration import find_image_shifts
from rig import Notice, figure, pluralize
from rig.arrays import Bool, Float64

# ``auto``: if images are surely shifted; ``always``: also by less; ``off``: never.
AlignChoice = Literal["auto", "off", "always"]

# Shifts that are corrected by default, and those that are left as they are.
_SHIFTED_PX: Final = 0.15
_LEFT_PX: Final = 0.05
# What is left of shifts of spheres: they are nearer to the camera than parts of the object.
_BY_SPHERES_PX: Final = 1.0
# Lights may turn by the first; by more than the second, if the images do not show which moved,
# normals would be wrong by a degree or more.
_SAFE_DEG, _REFUSED_DEG = 0.3, 2.0
# One explanation is better if the mean of its advantages over the images exceeds so many standard
# deviations.
_CLEAR: Final = 2.5
# Pixels that are compared, the least share of the brightest sample that is lit, and steps.
_SAMPLES, _LIT, _ROUNDS, _RIDGE = 2000, 0.1, 100, 1e-9
# Below this, a first look is enough.
_STILL_PX: Final = 0.1


class Alignment(NamedTuple):
    """Shifts to correct, by the ids of the lights, and what to report."""

    shifts_px: dict[str, tuple[float, float]]
    notices: list[Notice]


def find_alignment(
    images: RecordedImages,
    lights: Lights,
    mask: Bool,
    view: View | None,
    choice: AlignChoice,
    known_px: Mapping[str, tuple[float, float]],
) -> Alignment:
    """Find by how much images are shifted, and decide which are moved back.

    Parameters
    ----------
    images
        N images.
    lights
        Their lights.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see points under near lights; None under distant ones.
    choice
        When to align.
    known_px
        By how much the images have been moved back already, by the ids of the lights, as spheres
        in them show. These shifts are refined if the object shows enough structure.

    Raises
    ------
    EstimateError
        If shifts must be found, and the images do not determine them.
    """
    nothing = Alignment({}, [])
    if choice == "off":
        return nothing

    def vectors_at(rows: Float64, columns: Float64) -> Float64:
        return np.moveaxis(lights.vectors_at(_points(rows, columns, mask, view)), 0, 1)

    forced, known = choice == "always", bool(known_px)
    before = np.array([known_px.get(name, (0.0, 0.0)) for name in images.ids])
    try:
        found = find_image_shifts(images, mask, vectors_at, 0.0 if forced or known else _STILL_PX)
        if not found.determined:
            raise EstimateError(
                "the images show too little structure to align them: fine detail or paint is needed"
            )
    except EstimateError:
        if forced:
            raise
        return Alignment(dict(known_px), [_notice(before, _BY_SPHERES_PX)] if known else [])
    if not known:
        least_px = _LEFT_PX if forced else _SHIFTED_PX
        if not found.significant(least_px).any() or not (forced or found.real):
            return nothing
    shifts = before + found.shifts_px
    # The image in the middle stays where it is, and with it those before or after a bump.
    between = np.linalg.norm(shifts[:, None] - shifts, axis=2)
    shifts -= shifts[np.argmin(between.sum(axis=1))]
    moved = np.hypot(*shifts.T) > _LEFT_PX
    by_name = {
        name: (right, down)
        for name, (right, down), one in zip(images.ids, shifts.tolist(), moved, strict=True)
        if one
    }
    return Alignment(by_name, [_notice(shifts[moved], float(np.hypot(*found.sigma_px.T).max()))])


def _points(rows: Float64, columns: Float64, mask: Bool, view: View | None) -> Float64:
    """Return the points ``(P, 3)`` that pixels see at the mean height."""
    height, width = mask.shape
    down = np.clip(np.rint(rows), 0, height - 1).astype(int)
    right = np.clip(np.rint(columns), 0, width - 1).astype(int)
    if view is None:
        return np.zeros((len(down), 3))
    numbers, of_row = np.unique(down, return_inverse=True)
    return np.asarray(view.points_of(numbers, view.distance_mm)[of_row, right])


def _notice(shifts_px: Float64, left_px: float) -> Notice:
    largest = float(np.hypot(*shifts_px.T).max(initial=0.0))
    count = len(shifts_px)
    text = (
        f"camera or object moved: {pluralize(count, 'image was', 'images were')} moved back by up "
        f"to {figure(largest)} px, and what is left is about {figure(left_px, 1)} px"
    )
    return Notice("images-aligned", text, severity="info")


def lights_of_moved(
    images: RecordedImages,
    lights: Lights,
    mask: Bool,
    view: View,
    shifts_px: Mapping[str, tuple[float, float]],
) -> tuple[Lights, list[Notice]]:
    """Return the lights of images that were moved back, in which camera or object moved.

    Near lights with known positions stay where they are relative to the object if the camera moved,
    and relative to the camera if the object did. The images, up to one factor each, show which: one
    of the two explains most of them better. If the camera moved, its usual place, where the lights
    have these positions, is taken to be the median of all.

    Parameters
    ----------
    images
        Images that are moved back.
    lights
        Lights with positions, those of the images among them.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see points.
    shifts_px
        By how much the images were moved back, by the ids of the lights.

    Raises
    ------
    EstimateError
        If the images do not show it, and lights turn by more than 2 degrees.
    """
    rows, columns = np.nonzero(mask)
    some = np.unique(np.linspace(0, len(rows) - 1, _SAMPLES).astype(int))
    points = _points(rows[some], columns[some], mask, view)
    scale = float(np.ptp(points[:, 0])) / max(1, int(np.ptp(columns[some])))
    by_mm = np.array([(*shifts_px.get(name, (0.0, 0.0)), 0.0) for name in lights.ids])
    by_mm *= [scale, -scale, 0.0]
    here, middle = np.asarray(lights.positions_mm), points.mean(axis=0)
    turned_deg = float(angle_deg(here - middle, here - by_mm - middle).max())
    if turned_deg < _stated_deg(lights):
        return lights, []
    which = [lights.ids.index(name) for name in images.ids]
    usual = _displaced(lights, np.median(by_mm[which], axis=0))
    other = _displaced(lights, by_mm)
    values = np.array([image[rows[some], columns[some]] for image in images], np.float64).T
    left = [
        _left(values, np.moveaxis(one.take(which).vectors_at(points), 0, 1))
        for one in (usual, other)
    ]
    spread = min(float(np.nanmedian(one)) for one in left)
    losses = [np.nanmean(np.log1p((one / (3 * spread)) ** 2), axis=0) for one in left]
    far_mm = np.hypot(*by_mm[which, :2].T)
    far = far_mm > far_mm.max() / 5
    better = (losses[1] - losses[0])[far] / far_mm[far]
    clear = float(better.mean() / max(better.std(ddof=1) / len(better) ** 0.5, 1e-12))
    far = figure(far_mm.max())
    moved = f"by up to {far} mm, which turns lights by up to {turned_deg:.1f} degrees"
    if clear > _CLEAR:
        return usual, []
    if clear < -_CLEAR:
        text = f"the object moved under fixed lights, {moved}: this was taken into account"
        return other, [Notice("object-moved", text, severity="info")]
    text = f"camera or object moved, {moved} if it was the object; the images do not show which"
    if turned_deg > _REFUSED_DEG:
        raise EstimateError(f"{text}: record it again, with camera and object fixed")
    return usual, [Notice("lights-may-have-moved", f"{text}; it is taken to be the camera")]


def _displaced(lights: Lights, by_mm: Float64) -> Lights:
    """Return the same lights as seen from an object that has moved by ``(3,)`` or ``(N, 3)``."""
    here = np.asarray(lights.positions_mm)
    nearer = np.linalg.norm(here, axis=1) / np.linalg.norm(here - by_mm, axis=1)
    strengths = np.asarray(lights.intensities) * nearer[:, None] ** 2
    return replace(lights, positions_mm=here - by_mm, intensities=strengths)


def _stated_deg(lights: Lights) -> float:
    """Return by how much lights may turn: by their standard deviations, or by a little."""
    if lights.errors is None or lights.errors.covariances is None:
        return _SAFE_DEG
    sigma_mm = np.sqrt(np.trace(lights.errors.covariances, axis1=1, axis2=2) / 3)
    distance_mm = np.linalg.norm(np.asarray(lights.positions_mm), axis=1)
    stated = float(np.degrees(np.nanmedian(sigma_mm / distance_mm)))
    return max(_SAFE_DEG, stated) if np.isfinite(stated) else _SAFE_DEG


def _left(values: Float64, vectors: Float64) -> Float64:
    """Return what a matte surface under lights of free strengths leaves of samples ``(P, N)``.

    NaN where a sample does not count, such as in shadows.
    """
    values = np.nan_to_num(values)
    lit = values > _LIT * values.max(axis=1, keepdims=True)
    strengths, weights = np.ones(values.shape[1]), lit.astype(np.float64)
    for _ in range(_ROUNDS):
        rows = vectors * strengths[:, None]
        weighted = weights[..., None] * rows
        system = weighted.transpose(0, 2, 1) @ rows + _RIDGE * np.eye(3)
        normals = np.linalg.solve(system, weighted.transpose(0, 2, 1) @ values[..., None])
        plain = (vectors @ normals)[..., 0]
        strengths = (weights * plain * values).sum(axis=0) / (weights * plain**2).sum(axis=0)
        off = np.abs(values - strengths * plain)
        weights = lit / (1 + (off / (3 * np.median(off[lit]))) ** 2)
    return np.where(lit, off, np.nan)
