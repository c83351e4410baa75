"""The exemplar of a synthesis: copies of a detail, and the places at which a patch fits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np
from scipy.optimize import nnls

from acquisition import DataError
from processing.maps.normal_map import NormalMap
from rig.arrays import AnyArray, Bool, Float32, Float64, Int32, Intp

_ROUNDS = 20
# Rounding errors of the use of a pixel that is in no patch are smaller.
_UNUSED = 1e-5
_LEVELS = 32
# The mean angle counts more than a level of its distribution, even use less, the sum most.
_MEAN, _EVEN, _SUM = 3.0, 0.1, 100.0
# A smaller mean angle is noise of files: nothing that could be continued.
FLAT_DEG = 0.01
# Classes of steepness of patches.
CLASSES = 24


@dataclass(frozen=True, eq=False)
class Exemplar:
    """A detail, its turned and mirrored copies, and the places at which a patch fits.

    Parameters
    ----------
    vectors
        ``(copies, h, w, 3)`` float32; copies that are narrower or lower are padded with 0.
    slopes
        ``(copies, h, 2 w)``: n_x and n_y of the same.
    classes
        ``(copies, h, w)`` int32: class of steepness of the patch that starts here, -1 if a patch
        does not fit into the mask.
    starts
        Flat indices of the places where a patch fits.
    shares
        Share of the patches that should be of each class.
    mean_energy
        Mean of n_x^2 + n_y^2 over the mask.
    """

    vectors: Float32
    slopes: Float32
    classes: Int32
    starts: Int32
    shares: Float64
    mean_energy: float


def prepare_exemplar(detail: NormalMap, patch: int, *, rotate: bool, mirror: bool) -> Exemplar:
    """Prepare a detail for a size of patches.

    Raises
    ------
    DataError
        If the detail is flat, or no patch fits into its mask.
    """
    height, width = detail.size
    if min(height, width) < patch:
        raise DataError(
            f"the exemplar has {width} x {height} pixels, less than a patch of {patch} x {patch}: "
            "use a larger exemplar or smaller patches"
        )
    steep = np.hypot(detail.normals[..., 0], detail.normals[..., 1])
    angle = np.arctan2(steep, detail.normals[..., 2])
    mean = math.degrees(np.mean(angle[detail.mask], dtype=np.float64))
    if mean < FLAT_DEG:
        raise DataError(
            f"the exemplar is flat: its mean detail angle is {mean:.2g} degrees, so it has no "
            "texture that could be continued"
        )
    places = places_of(detail.mask, patch)
    if not places.any():
        raise DataError(
            f"no patch of {patch} x {patch} pixels fits into the mask of the exemplar: use an "
            "exemplar without holes or smaller patches"
        )
    classes = _steepness(angle, places, patch)
    shares = _class_shares(angle, classes, detail.mask, patch)
    copies = [
        _turned(detail.normals, classes, quarter, flip, patch)
        for quarter, flip in turns(rotate, mirror)
    ]
    vectors = padded([normals for normals, _ in copies], 0)
    every = padded([numbers for _, numbers in copies], -1)
    starts = np.flatnonzero(every >= 0).astype(np.int32)
    slopes = np.ascontiguousarray(vectors[..., :2]).reshape(*every.shape[:2], -1)
    energy = float(np.mean(steep[detail.mask] ** 2, dtype=np.float64))
    return Exemplar(vectors, slopes, every, starts, shares, energy)


def mean_angle(vectors: Float32) -> float:
    """Return the mean angle to z in radians of ``(..., 3)`` unit vectors."""
    angles = np.arctan2(np.hypot(vectors[..., 0], vectors[..., 1]), vectors[..., 2])
    return float(np.mean(angles, dtype=np.float64))


def turns(rotate: bool, mirror: bool) -> list[tuple[int, bool]]:
    """Return the copies of an exemplar: quarters of a turn, and whether it is mirrored then."""
    return list(product(range(4 if rotate else 1), (False, True) if mirror else (False,)))


def padded(copies: list[AnyArray], fill: float) -> AnyArray:
    """Return arrays of different (height, width) as one, filled up below and at the right."""
    side = np.max([one.shape[:2] for one in copies], axis=0)
    whole = np.full((len(copies), *side, *copies[0].shape[2:]), fill, copies[0].dtype)
    for place, one in zip(whole, copies, strict=True):
        place[: one.shape[0], : one.shape[1]] = one
    return whole


def places_of(mask: Bool, patch: int) -> Bool:
    """Return where a patch that starts there lies inside a mask."""
    kernel = np.ones((patch, patch), np.uint8)
    inside = cv2.erode(
        mask.astype(np.uint8), kernel, anchor=(0, 0), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    return np.asarray(inside > 0)


def _steepness(angle: Float32, places: Bool, patch: int) -> Int32:
    """Return the class of each place by the mean angle of its patch, -1 where no patch fits.

    The classes have equal numbers of places.
    """
    means = _patch_means(angle, patch)[places]
    order = np.argsort(np.argsort(means, kind="stable"), kind="stable")
    classes = np.full(places.shape, -1, np.int32)
    # With fewer places than classes, some numbers have no place.
    classes[places] = np.unique(order * CLASSES // len(means), return_inverse=True)[1]
    return classes


def _turned(
    normals: Float32, classes: Int32, quarter: int, flip: bool, patch: int
) -> tuple[Float32, Int32]:
    """Turn a detail by quarters counter-clockwise, then mirror it left to right.

    The number of a place is at the first pixel of its patch, which is another corner of the patch
    after the turn.
    """
    x, y, z = normals[..., 0], normals[..., 1], normals[..., 2]
    for _ in range(quarter):
        x, y = -y, x
    turned = np.rot90(np.stack([x, y, z], axis=-1), quarter)
    room = classes[: classes.shape[0] - patch + 1, : classes.shape[1] - patch + 1]
    room = np.rot90(room, quarter)
    if flip:
        turned = turned[:, ::-1] * np.array([-1, 1, 1], np.float32)
        room = room[:, ::-1]
    numbers = np.full(turned.shape[:2], -1, np.int32)
    numbers[: room.shape[0], : room.shape[1]] = room
    return turned, numbers


def _class_shares(angle: Float32, classes: Int32, mask: Bool, patch: int) -> Float64:
    """Return the share of the patches that each class should have.

    Together, the pixels of the patches have nearly the distribution of angles that the exemplar
    has inside its mask, also where no patch fits. Otherwise the shares are those that use all
    pixels equally often.

    Parameters
    ----------
    angle
        ``(h, w)`` angles of the exemplar.
    classes
        ``(h, w)``: class of the patch that starts here, -1 where none fits.
    mask
        Where the exemplar has a normal.
    patch
        Side of the patches.
    """
    often = _even_use(classes >= 0, mask, patch)
    known = angle[mask]
    levels = np.quantile(known, np.arange(1, _LEVELS + 1) / (_LEVELS + 1))
    above = np.searchsorted(levels, angle)[mask]
    uses = [
        np.maximum(_use(np.where(classes == number, often, np.float32(0)), patch), 0)[mask]
        for number in range(classes.max() + 1)
    ]
    even = np.array([np.sum(use, dtype=np.float64) for use in uses])
    # Of each class, and of the exemplar: the shares of the pixels below each level.
    below = np.stack([_below(above, use) for use in uses], axis=1)
    wanted = _below(above, np.ones_like(known))
    means = np.array([np.average(known, weights=use) for use in uses])
    even /= even.sum()
    # Squared differences of the distributions, integrated over the angle, which the spread divides.
    spread = float(known.std(dtype=np.float64)) or 1.0
    width = np.sqrt(np.diff([*levels, known.max()]) / spread)
    rows = [
        width[:, None] * below,
        _MEAN * means[None] / spread,
        _EVEN * np.diag(1 / np.sqrt(even)),
        np.full((1, len(even)), _SUM),
    ]
    mean = float(np.mean(known, dtype=np.float64))
    goal = [width * wanted, [_MEAN * mean / spread], _EVEN * np.sqrt(even), [_SUM]]
    found = nnls(np.concatenate(rows), np.concatenate(goal))[0]
    return np.asarray(found / found.sum())


def _below(above: Intp, use: Float32) -> Float64:
    """Return the share of the use of pixels below each level; ``above`` counts levels."""
    counts = np.bincount(above, use, minlength=_LEVELS + 1)
    return np.asarray(np.cumsum(counts)[:-1] / counts.sum())


def _even_use(places: Bool, mask: Bool, patch: int) -> Float32:
    """Return how often to start a patch at each place, so that pixels are used equally often.

    A pixel at a border of the mask is in fewer patches than one inside. The frequencies that make
    up for it are found by the multiplicative iteration of Richardson and Lucy.
    """
    often = places.astype(np.float32)
    for _ in range(_ROUNDS):
        use = _use(often, patch)
        missing = np.where(mask & (use > _UNUSED), 1 / np.maximum(use, _UNUSED), 0)
        often *= _patch_means(missing.astype(np.float32), patch)
    return often


def _use(often: Float32, patch: int) -> Float32:
    """Return how often each pixel is used if patches start at the places this often."""
    corner = (patch - 1, patch - 1)
    use = cv2.boxFilter(often, -1, (patch, patch), anchor=corner, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(use, np.float32)


def _patch_means(values: Float32, patch: int) -> Float32:
    """Return the mean of the patch that starts at each pixel; pixels outside count as 0."""
    means = cv2.boxFilter(values, -1, (patch, patch), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(means, np.float32)
