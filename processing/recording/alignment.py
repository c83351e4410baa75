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
from rig import Notice, pluralize
from rig.arrays import Bool, Float64

# ``auto``: if images are surely shifted; ``always``: also by less; ``off``: never.
AlignChoice = Literal["auto", "off", "always"]

# Shifts that are corrected by default, and those that are left as they are.
_SHIFTED_PX: Final = 0.15
_LEFT_PX: Final = 0.05
# What is left of shifts of spheres: they are nearer to the camera than parts of the object.
_BY_SPHERES_PX: Final = 1.0
_SAFE_DEG: Final = 0.3
_SAMPLES: Final = 4000
_LIT: Final = 0.1
_ROUNDS: Final = 12
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
    shifts -= np.median(shifts, axis=0)
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
        f"to {largest:.2g} px, and what is left is about {left_px:.1g} px"
    )
    return Notice("images-aligned", text, severity="info")


def lights_of_moved(
    images: RecordedImages,
    lights: Lights,
    mask: Bool,
    view: View,
    shifts_px: Mapping[str, tuple[float, float]],
) -> tuple[Lights, Notice | None]:
    """Return the lights of images that were moved back: near lights may have stood still.

    Lights whose positions are known stay where they are relative to the object if the camera moved,
    and relative to the camera if the object did. The images, up to one factor each, show which.

    Parameters
    ----------
    images
        Images that are moved back.
    lights
        Their lights, with positions.
    mask
        ``(H, W)`` bool, the object.
    view
        How the pixels see points.
    shifts_px
        By how much the images were moved back, by the ids of the lights.

    Raises
    ------
    EstimateError
        If the images do not show it, and it matters too much.
    """
    rows, columns = np.nonzero(mask)
    some = np.unique(np.linspace(0, len(rows) - 1, _SAMPLES).astype(int))
    rows, columns = rows[some], columns[some]
    points = _points(rows, columns, mask, view)
    scale = np.ptp(points[:, 0]) / max(1, int(np.ptp(columns)))
    by_mm = np.zeros((len(lights), 3))
    by_mm[:, :2] = [shifts_px.get(name, (0.0, 0.0)) for name in lights.ids]
    by_mm *= [scale, -scale, 0]
    here, middle = np.asarray(lights.positions_mm), points.mean(axis=0)
    nearer = np.linalg.norm(here, axis=1) / np.linalg.norm(here - by_mm, axis=1)
    strengths = np.asarray(lights.intensities) * nearer[:, None] ** 2
    other = replace(lights, positions_mm=here - by_mm, intensities=strengths)
    turned_deg = float(angle_deg(here - middle, here - by_mm - middle).max())
    if turned_deg < _SAFE_DEG:
        return lights, None
    values = np.array([image[rows, columns] for image in images], np.float64).T
    costs = [_misfit(values, np.moveaxis(one.vectors_at(points), 0, 1)) for one in (lights, other)]
    gain = 1 - costs[1][1] / costs[0][1]
    sp = min(costs[0][1], costs[1][1])
    a, b = (np.nanmean(np.log1p((one[0] / (2 * sp)) ** 2), axis=0) for one in costs)
    d = b - a
    print("REL", 1 - b.mean() / a.mean())
    m=np.hypot(*by_mm[:,:2].T)>0.2*np.hypot(*by_mm[:,:2].T).max()
    t = d[m].mean() / (d[m].std(ddof=1) / m.sum()**.5)
    print('T',t, d.mean())
    far_mm = float(np.hypot(*by_mm[:, :2].T).max())
    print("GAIN", gain, turned_deg)
    return lights, None


def _misfit(values: Float64, vectors: Float64) -> float:
    """Return how badly a matte surface under lights of unknown strengths explains ``(P, N)``."""
    known = np.isfinite(values)
    values = np.where(known, values, 0)
    lit = known & (values > _LIT * values.max(axis=1, keepdims=True))
    strengths, weights = np.ones(values.shape[1]), lit.astype(np.float64)
    for _ in range(_ROUNDS):
        rows = vectors * strengths[:, None]
        weighted = weights[..., None] * rows
        system = weighted.transpose(0, 2, 1) @ rows + 1e-9 * np.eye(3)
        normals = np.linalg.solve(system, weighted.transpose(0, 2, 1) @ values[..., None])
        plain = (vectors @ normals)[..., 0]
        strengths = (weights * plain * values).sum(axis=0) / (weights * plain**2).sum(axis=0)
        off = np.abs(values - strengths * plain)
        spread = 1.4826 * np.median(off[lit])
        weights = lit / (1 + (off / (2 * spread)) ** 2)
    return np.where(lit, off, np.nan), spread
