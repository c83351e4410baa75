"""Detail inside holes, quilted from the surroundings of each hole."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import cv2
import numpy as np

from acquisition import DataError
from processing.detail.seam import blend_from, seam_steps
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap
from processing.synthesis.exemplar import FLAT_DEG, Exemplar, mean_angle, prepare_exemplar
from processing.synthesis.hole_kernels import HOLE, KNOWN, MADE, quilt_holes
from rig import Progress
from rig.arrays import Bool, Float32, Int32, Intp

_CANDIDATES = 4800
# The largest factor on slopes that makes a filled hole as steep as its surroundings.
_MOST_GAIN = 1.5
# The surroundings reach this many patches at first, and further until they have enough places. A
# hole becomes as steep as what is within the first reach.
_REACH_PATCHES = 3
_PLACES = 1000
# Each hole is filled with its windows at this many positions along both axes; the filling with the
# smallest step at the rim is kept.
_SHIFTS = 4
# The factor that makes a hole as steep as its surroundings is found again after the blend.
_BLENDS = 2
_STEPS = ((0, 1), (0, -1), (1, 1), (1, -1))


def fill_detail(
    detail: NormalMap,
    holes: Bool,
    *,
    patch: int,
    overlap: int,
    seed: int,
    blend_px: float,
    on_progress: Progress,
) -> tuple[Float32, Bool]:
    """Fill holes in a detail component from their surroundings.

    Holes that are near each other are filled together. Without texture around it, a hole has no
    detail.

    Parameters
    ----------
    detail
        Known around the holes.
    holes
        ``(H, W)`` bool, outside the mask of the detail.
    patch, overlap, seed
        As for `fill_holes`.
    blend_px
        Distance from the rim at which the difference of patches and known detail has fallen to 1/e.
    on_progress
        Receives the stage ``filling``: pixels in filled holes, after each group of holes.

    Returns
    -------
    tuple[Float, Mask]
        ``(H, W, 3)`` vectors, and the known pixels that patches were taken from.

    Raises
    ------
    DataError
        If no patch fits into the surroundings of a hole.
    """
    normals, used = detail.normals.copy(), np.zeros(holes.shape, np.bool_)
    total, done = int(np.count_nonzero(holes)), 0
    for group, box in _groups(holes, patch):
        box, around = _surroundings(detail.mask, group, box, patch)
        part = NormalMap(np.where(around[..., None], detail.normals[box], 0), around)
        if math.degrees(mean_angle(part.normals[around])) < FLAT_DEG:
            normals[box][group[box]] = (0, 0, 1)
        else:
            exemplar = prepare_exemplar(part, patch, rotate=False, mirror=False)
            given, known, inside = normals[box], detail.mask[box], group[box]
            near = known & (_away(inside) <= _REACH_PATCHES * patch)
            angle = mean_angle(given[near])
            shifts = range(0, patch, -(-patch // _SHIFTS))
            attempts = (
                _filled(
                    given, known, inside, exemplar, angle, patch, overlap, shift, seed, blend_px
                )
                for shift in product(shifts, shifts)
            )
            everything = known | inside
            normals[box] = min(attempts, key=lambda made: _rim_step_deg(made, everything, inside))
        used[box] |= around
        done += int(np.count_nonzero(group))
        on_progress("filling", done, total)
    return normals, used


def _groups(holes: Bool, patch: int) -> Iterator[tuple[Bool, tuple[slice, slice]]]:
    """Yield masks of the holes that are less than a patch apart, with their bounding boxes."""
    near = cv2.dilate(holes.astype(np.uint8), np.ones((patch, patch), np.uint8))
    count, labels = cv2.connectedComponents(near, connectivity=8)
    labels[~holes] = 0
    for number in range(1, count):
        group = labels == number
        yield group, bounding_box(group)


def _surroundings(
    known: Bool, group: Bool, box: tuple[slice, slice], patch: int
) -> tuple[tuple[slice, slice], Bool]:
    """Return a box around holes, and the known pixels in it that patches are taken from."""
    reach = _REACH_PATCHES * patch
    while True:
        wide = (
            slice(max(box[0].start - reach, 0), min(box[0].stop + reach, group.shape[0])),
            slice(max(box[1].start - reach, 0), min(box[1].stop + reach, group.shape[1])),
        )
        around = known[wide] & (_away(group[wide]) <= reach)
        kernel = np.ones((patch, patch), np.uint8)
        room = cv2.erode(around.astype(np.uint8), kernel, borderType=cv2.BORDER_CONSTANT)
        places = int(np.count_nonzero(room))
        everything = reach >= max(group.shape)
        if places >= _PLACES or (everything and places):
            return wide, around
        if everything:
            row, column = (int(values[0]) for values in np.nonzero(group))
            raise DataError(
                f"no patch of {patch} x {patch} pixels fits into the normals around the hole at "
                f"column {column}, row {row}: use smaller patches"
            )
        reach *= 2


def _away(holes: Bool) -> Float32:
    """Return the distance of each pixel to holes in pixels."""
    return np.asarray(cv2.distanceTransform((~holes).astype(np.uint8), cv2.DIST_L2, 3))


def _filled(
    normals: Float32,
    known: Bool,
    holes: Bool,
    exemplar: Exemplar,
    angle: float,
    patch: int,
    overlap: int,
    shift: tuple[int, int],
    seed: int,
    blend_px: float,
) -> Float32:
    state = np.zeros(holes.shape, np.uint8)
    state[known], state[holes] = KNOWN, HOLE
    sheet, sources = normals.copy(), np.full(holes.shape, -1, np.int32)
    vectors = exemplar.vectors[0]
    windows = _windows(known, holes, patch, overlap, shift)
    quilt_holes(
        sheet, state, sources, windows, overlap, patch, vectors, exemplar.slopes[0],
        exemplar.starts, exemplar.classes[0], exemplar.shares, exemplar.mean_energy, _CANDIDATES,
        seed,
    )  # fmt: skip
    # At the rim: what the exemplar has next to the pixel that a pixel of the hole was copied from.
    rim = np.zeros(holes.shape, np.bool_)
    for axis, step in _STEPS:
        behind = np.roll(sources, step, axis)
        behind[(slice(None),) * axis + ((0,) if step == 1 else (-1,),)] = -1
        row, column = np.divmod(behind, vectors.shape[1])
        row, column = (row + step, column) if axis == 0 else (row, column + step)
        row = np.clip(row, 0, vectors.shape[0] - 1)
        column = np.clip(column, 0, vectors.shape[1] - 1)
        beyond = vectors[row, column]
        found = (state == KNOWN) & (behind >= 0) & ~rim & beyond.any(axis=2)
        sheet[found] = beyond[found]
        rim |= found
    region, holes = rim | (state == MADE), state == MADE
    blended = sheet
    for _ in range(_BLENDS):
        gain = angle / max(mean_angle(blended[holes]), 1e-9)
        sheet[region] = _scaled(sheet[region], min(max(gain, 1 / _MOST_GAIN), _MOST_GAIN))
        blended = blend_from(sheet, normals, rim, region, blend_px)
    return blended


def _rim_step_deg(normals: Float32, known: Bool, holes: Bool) -> float:
    """Return the mean step across the rim of filled holes, or 0 if they have no rim."""
    step = seam_steps(NormalMap.of_unit_vectors(normals, known), holes).seam_deg
    return 0.0 if math.isnan(step) else step


def _scaled(vectors: Float32, factor: float) -> Float32:
    """Return unit vectors with their slopes multiplied."""
    longer = vectors * np.array([factor, factor, 1], np.float32)
    return np.asarray(longer / np.linalg.norm(longer, axis=1, keepdims=True), np.float32)


def _windows(known: Bool, holes: Bool, patch: int, overlap: int, shift: tuple[int, int]) -> Int32:
    """Return the windows to fill, from the rim inwards, with the bands that they share.

    Their positions are shifted upwards and to the left by up to `shift` pixels.
    """
    tops, lefts = (
        _positions(
            np.flatnonzero(holes.any(axis=1 - axis)), holes.shape[axis], patch, overlap, shift[axis]
        )
        for axis in (0, 1)
    )
    far = cv2.distanceTransform((~known).astype(np.uint8), cv2.DIST_L2, 3)
    order = []
    for i, top in enumerate(tops):
        for j, left in enumerate(lefts):
            window = slice(top, top + patch), slice(left, left + patch)
            if holes[window].any():
                order.append((float(far[window][holes[window]].mean()), i, j))
    windows, placed = np.zeros((len(order), 6), np.int32), set()
    for number, (_, i, j) in enumerate(sorted(order)):
        top, left = int(tops[i]), int(lefts[j])
        windows[number] = (
            top,
            left,
            lefts[j - 1] + patch - left if (i, j - 1) in placed else 0,
            tops[i - 1] + patch - top if (i - 1, j) in placed else 0,
            left + patch - lefts[j + 1] if (i, j + 1) in placed else 0,
            top + patch - tops[i + 1] if (i + 1, j) in placed else 0,
        )
        placed.add((i, j))
    return windows


def _positions(inside: Intp, length: int, patch: int, overlap: int, shift: int) -> Int32:
    """Return the first pixels of windows that cover holes and an overlap around them."""
    first = max(int(inside[0]) - overlap - shift, 0)
    last = min(int(inside[-1]) + 1 + overlap, length)
    count = max(-(-(last - first - overlap) // (patch - overlap)), 1)
    excess = count * (patch - overlap) + overlap - (last - first)
    start = min(max(first - excess // 2, 0), length - patch)
    end = min(start + (count - 1) * (patch - overlap), length - patch)
    return np.unique(np.linspace(start, end, count).round()).astype(np.int32)
