"""Synthesis of a detail component over the mask of a target, following its surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import distance_transform_edt

from acquisition import DataError
from processing.curvatures.slopes import curvature
from processing.detail.seam import SeamSteps
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap, check_normal_map
from processing.synthesis.exemplar import Exemplar, padded, prepare_exemplar, turns
from processing.synthesis.footprint_search import Places
from processing.synthesis.quilting import (
    BALANCE,
    CANDIDATES,
    check_options,
    diagonals,
    overlap_of,
    positions,
)
from processing.synthesis.seam_steps import cut_steps
from processing.synthesis.warped_kernels import place_warped
from rig import Progress, in_threads, no_progress
from rig.arrays import Bool, Float32, Float64, UInt8

_LEAST_SCALE, _MOST_SCALE = 0.1, 10.0
_MOST_WEIGHT = 100.0
# Curvature is fitted over this share of a patch, and its direction smoothed over half a patch.
_FITTED, _SMOOTHED = 8, 2
_LEAST_FIT, _MOST_FIT = 2.0, 100.0
# Largest stretch along the tilt: 75.5 degrees.
_MOST_STRETCH = 4.0


class _PatternField(NamedTuple):
    """The map from steps in the image to steps in the exemplar.

    Parameters
    ----------
    steps
        ``(H, W, 2, 2)`` float32: (down, right) in the exemplar for one pixel (down, right) in the
        image.
    turn
        ``(H, W)`` float32: angle in rad, counter-clockwise, from the x axis of the detail's frame
        to that of the pattern.
    """

    steps: Float32
    turn: Float32


def _pattern_field(
    shape: NormalMap,
    *,
    image_space: bool = False,
    direction_deg: Float32 | None = None,
    scale: Float32 | None = None,
) -> _PatternField:
    """Return the map from a target to a pattern that follows arc length on its surface.

    A step d in the image is the step J d in the tangent plane, in the axes that the shortest
    rotation from z to the normal s makes of x and y: ``J = I + s s^T / (s_z (1 + s_z))`` with
    s = (s_x, s_y). It stretches by 1 / s_z along the tilt, and by 1 across it.

    Parameters
    ----------
    shape
        Shape component of the target. Pixels outside its mask have the map of the nearest pixel
        inside.
    image_space
        The pattern follows the image instead: J is the identity.
    direction_deg
        ``(H, W)`` direction in the image that the x axis of the pattern follows, counter-clockwise
        from X; finite on the mask.
    scale
        ``(H, W)`` size of the pattern relative to the exemplar; positive on the mask.
    """
    normals = shape.normals.astype(np.float64)
    z = np.maximum(normals[..., 2], 1 / _MOST_STRETCH)
    # Down instead of up. Beyond the limit, the direction of the tilt is kept.
    tilt = np.stack([-normals[..., 1], normals[..., 0]], axis=-1)
    most = np.sqrt(1 - z * z)
    tilt *= (most / np.maximum(np.hypot(*np.moveaxis(tilt, -1, 0)), most + 1e-12))[..., None]
    jacobian = np.zeros((*shape.size, 2, 2))
    jacobian[...] = np.eye(2)
    if not image_space:
        jacobian += tilt[..., :, None] * tilt[..., None, :] / (z * (1 + z))[..., None, None]
    turn = np.zeros(shape.size)
    if direction_deg is not None:
        angle = np.radians(np.where(shape.mask, direction_deg, 0))
        step = np.stack([-np.sin(angle), np.cos(angle)], axis=-1)
        down, right = np.moveaxis(np.einsum("...ij,...j", jacobian, step), -1, 0)
        turn = np.arctan2(-down, right)
        c, s = np.cos(turn), np.sin(turn)
        # Counter-clockwise by -turn, in (down, right).
        rotation = np.stack([np.stack([c, s], -1), np.stack([-s, c], -1)], -2)
        jacobian = rotation @ jacobian
    if scale is not None:
        jacobian /= np.where(shape.mask, scale, 1)[..., None, None]
    y, x = distance_transform_edt(~shape.mask, return_distances=False, return_indices=True)
    return _PatternField(jacobian[y, x].astype(np.float32), turn[y, x].astype(np.float32))


@dataclass(frozen=True, eq=False)
class TargetSynthesis:
    """A detail component that was synthesised over the mask of a target.

    Parameters
    ----------
    detail
        The detail, known on the mask of the target. `combine` puts it on a shape.
    labels
        ``(H, W)`` uint8: pixels of the same patch have the same number, pixels of patches that
        touch have different ones.
    patch, overlap
        Side of the patches in pixels of the image, and the width of their overlap.
    compressed
        Share of the pixels in patches whose footprint did not fit into the exemplar: the pattern is
        smaller there.
    """

    detail: NormalMap
    labels: UInt8
    patch: int
    overlap: int
    compressed: float

    def __repr__(self) -> str:
        used = f"patch={self.patch}, overlap={self.overlap}, compressed={self.compressed:.3f}"
        return f"TargetSynthesis({self.detail!r}, {used})"

    @cached_property
    def steps(self) -> SeamSteps:
        """Mean angles between neighbouring normals, across cuts and inside patches."""
        return cut_steps(self.detail.normals, self.labels)


def synthesize_onto(
    exemplar: NormalMap,
    shape: NormalMap,
    *,
    patch: int = 48,
    overlap: int | None = None,
    seed: int = 0,
    rotate: bool = False,
    mirror: bool = False,
    image_space: bool = False,
    direction_deg: npt.ArrayLike | Literal["curvature"] | None = None,
    scale: npt.ArrayLike | None = None,
    guide: npt.ArrayLike | None = None,
    exemplar_guide: npt.ArrayLike | None = None,
    guide_weight: float = 1.0,
    on_progress: Progress = no_progress,
) -> TargetSynthesis:
    """Synthesise a detail component over the mask of a target by image quilting on its surface.

    The pattern follows arc length on the surface: on a slope it is foreshortened as the surface is.
    Each patch of the image shows a part of the exemplar through a map whose derivative is, as
    nearly as the curvature allows, that from the image into the tangent plane (compare Lefebvre and
    Hoppe, *Appearance-space texture synthesis*, 2006, section 4). Patches are joined as by
    `synthesize`.

    Parameters
    ----------
    exemplar
        Detail component, for instance of `separate`. Patches lie inside its mask.
    shape
        Shape component of the target, for instance of `separate`. On slopes of more than 75 degrees
        the pattern is not compressed further.
    patch
        Side of the square patches in pixels of the image, at least 6. Structures larger than a
        patch are lost.
    overlap
        Width of the overlap of neighbouring patches in pixels, 2 to a third of the patch. Default:
        a quarter of the patch.
    seed
        Fixes all random choices, 0 to 2^63 - 1. The result does not depend on the number of
        threads.
    rotate, mirror
        Also use copies of the exemplar that are turned by 90, 180 and 270 degrees, or mirrored,
        with their normals.
    image_space
        The pattern follows the pixels of the image instead of arc length.
    direction_deg
        ``(H, W)`` direction in the image, in degrees counter-clockwise from X, that the x axis of
        the exemplar follows; or ``"curvature"``: the direction of the largest curvature of the
        shape. Directions that differ by 180 degrees are the same grain.
    scale
        ``(H, W)`` size of the pattern relative to the exemplar, 0.1 to 10. A smaller pattern loses
        its finest parts, and its slopes are multiplied by up to 1.5 to keep the mean angle.
    guide, exemplar_guide
        ``(H, W)`` of the target and ``(h, w)`` of the exemplar, in the same unit: parts of the
        exemplar are placed where the target has similar values. How often flat and steep parts are
        used then follows the guide, not the exemplar.
    guide_weight
        Weight of the guide, up to 100: with 1, a difference of one standard deviation of the
        exemplar's guide costs as much as a patch that does not continue its neighbours at all.
    on_progress
        Receives the stages ``preparing`` and ``synthesising``, the latter with numbers of patches.

    Returns
    -------
    TargetSynthesis
        The detail on the mask of the target, float32. ``combine(shape, detail)`` puts it on the
        shape.

    Raises
    ------
    DataError
        If the exemplar is smaller than a patch, flat, or its mask has no room for a patch; if a
        number is out of range; if a map has another size or no number at a pixel of its mask.
    EstimateError
        If the shape has no curvature that the pattern could follow.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, combine, synthesize_onto
    >>> noise = np.random.default_rng(0).normal(scale=0.2, size=(64, 64, 3))
    >>> rough = NormalMap.from_vectors(noise + [0, 0, 1])
    >>> y, x = np.mgrid[1:-1:80j, -1:1:90j]
    >>> bowl = NormalMap.from_vectors(np.dstack([x, y, 0 * x + 2]))
    >>> combine(bowl, synthesize_onto(rough, bowl, patch=16).detail)
    NormalMap(float32[80, 90, 3], 7200 normals)
    """
    check_normal_map("exemplar", exemplar)
    check_normal_map("shape", shape)
    overlap = overlap_of(patch, overlap)
    check_options(patch, overlap, seed)
    on_progress("preparing", 0, 1)
    pair = _guide_pair(guide, exemplar_guide, guide_weight, shape.mask, exemplar.mask)
    window = bounding_box(shape.mask)
    mask = shape.mask[window]
    part = NormalMap.of_unit_vectors(shape.normals[window], mask)
    turned = None
    if isinstance(direction_deg, str):
        turned = _curvature_direction_deg(part, patch)
    elif direction_deg is not None:
        turned = _checked_map("direction map", direction_deg, shape.mask)[window]
    sizes = None
    if scale is not None:
        sizes = _checked_map("scale map", scale, shape.mask)[window]
        least, most = float(sizes.min()), float(sizes.max())
        if least < _LEAST_SCALE or most > _MOST_SCALE:
            raise DataError(
                f"the scale map has values from {least:.3g} to {most:.3g}: use {_LEAST_SCALE:g} to "
                f"{_MOST_SCALE:g}"
            )
    field = _pattern_field(part, image_space=image_space, direction_deg=turned, scale=sizes)
    made = prepare_exemplar(exemplar, patch, rotate=rotate, mirror=mirror)
    places, aim = _places(made), np.zeros((0, 0), np.float32)
    if pair is not None:
        aim = pair[0][window]
        places = places._replace(guide=_guide_copies(pair[1], rotate=rotate, mirror=mirror))
    sheet, labels, shrunk = _fill(
        field, mask, aim, places, made.shares, patch, overlap, seed, on_progress
    )
    normals = np.zeros((*shape.size, 3), np.float32)
    normals[window] = np.where(mask[..., None], sheet, 0)
    numbers = np.zeros(shape.size, np.uint8)
    numbers[window] = labels
    compressed = float(np.mean(shrunk[mask]))
    detail = NormalMap.of_unit_vectors(normals, shape.mask)
    return TargetSynthesis(detail, numbers, patch, overlap, compressed)


def _places(exemplar: Exemplar) -> Places:
    outside = np.all(exemplar.vectors == 0, axis=-1).astype(np.uint8)
    holes = np.stack([np.asarray(cv2.integral(copy), np.int32) for copy in outside])
    slopes, penalty = exemplar.slopes.reshape(-1, 2), np.ones(len(exemplar.shares))
    return Places(
        exemplar.vectors, slopes, exemplar.classes, exemplar.starts, holes, penalty,
        exemplar.mean_energy, np.zeros(0, np.float32),
    )  # fmt: skip


def _fill(
    field: _PatternField,
    mask: Bool,
    guide: Float32,
    places: Places,
    shares: Float64,
    patch: int,
    overlap: int,
    seed: int,
    on_progress: Progress,
) -> tuple[Float32, UInt8, Bool]:
    """Place all patches that contain a pixel of the mask, diagonal by diagonal.

    Returns the detail, the labels, and where footprints were made smaller.
    """
    rows, columns = (positions(length, patch, overlap, False) for length in mask.shape)
    # The last patches may leave the target.
    beyond = [(0, int(p[-1]) + patch - n) for p, n in zip((rows, columns), mask.shape, strict=True)]
    steps = np.pad(field.steps, [*beyond, (0, 0), (0, 0)], mode="edge")
    turn = np.pad(field.turn, beyond, mode="edge")
    guide = np.pad(guide, beyond, mode="edge") if guide.size else guide
    sheet = np.zeros((*turn.shape, 3), np.float32)
    labels, shrunk = np.zeros(turn.shape, np.uint8), np.zeros(turn.shape, np.bool_)
    wanted = np.array(
        [[mask[y : y + patch, x : x + patch].any() for x in columns] for y in rows], np.bool_
    )
    uses, placed, total = np.zeros(len(shares)), 0, int(np.count_nonzero(wanted))
    for patch_of in diagonals(len(rows), len(columns), False):
        r, c = patch_of[wanted[patch_of[:, 0], patch_of[:, 1]]].T
        if not r.size:
            continue
        patches = np.stack([r, c, rows[r], columns[c]], axis=1).astype(np.int32)
        bands = np.zeros_like(patches)
        # A patch that was left out has no pixel of the mask, so its cut is not seen.
        bands[:, 0] = np.where((c > 0) & wanted[r, c - 1], overlap, 0)
        bands[:, 1] = np.where((r > 0) & wanted[r - 1, c], overlap, 0)
        used, factors = np.zeros(len(r), np.int32), np.ones(len(r), np.float32)
        # A guide decides how often each class is used.
        balance = 0.0 if guide.size else BALANCE
        penalty = ((uses + 1) / (placed * shares + 1)) ** balance
        in_threads(
            place_warped, len(r), sheet, labels, steps, turn, guide, patches, bands, patch,
            places._replace(penalty=penalty), CANDIDATES, seed, used, factors,
        )  # fmt: skip
        if not placed:  # the first patch waits for the compiler
            on_progress("preparing", 1, 1)
            on_progress("synthesising", 0, total)
        for i in np.flatnonzero(factors < 1):
            y, x = patches[i, 2:]
            shrunk[y : y + patch, x : x + patch] = True
        uses += np.bincount(used, minlength=len(uses))
        placed += len(used)
        on_progress("synthesising", placed, total)
    room = slice(mask.shape[0]), slice(mask.shape[1])
    return sheet[room], labels[room], shrunk[room]


def _checked_map(name: str, values: npt.ArrayLike, mask: Bool) -> Float32:
    """Return a map as float32; outside the mask, it has the value of the nearest pixel inside.

    Raises
    ------
    DataError
        If the map has another size than the mask, or no number at a pixel of the mask.
    """
    array = np.asarray(values)
    if array.shape != mask.shape:
        has = f"{array.shape[1]} x {array.shape[0]} pixels" if array.ndim == 2 else "another shape"
        raise DataError(
            f"the {name} has {has}, but {mask.shape[1]} x {mask.shape[0]} are necessary: give a "
            "map with one value per pixel"
        )
    missing = np.count_nonzero(~np.isfinite(array[mask]))
    if missing:
        raise DataError(f"the {name} has no number at {missing} pixels inside the mask")
    y, x = distance_transform_edt(~mask, return_distances=False, return_indices=True)
    return np.asarray(array.astype(np.float32)[y, x])


def _guide_pair(
    guide: npt.ArrayLike | None,
    exemplar_guide: npt.ArrayLike | None,
    weight: float,
    mask: Bool,
    exemplar_mask: Bool,
) -> tuple[Float32, Float32] | None:
    """Return both guides in standard deviations of the exemplar's, times the root of the weight.

    Raises
    ------
    DataError
        If only one is given, a size is wrong, a number is missing, or the guide of the exemplar is
        the same everywhere.
    """
    if not 0 < weight <= _MOST_WEIGHT:
        raise DataError(f"a weight of {weight:g} of the guide is out of range: use up to 100")
    if guide is None and exemplar_guide is None:
        return None
    if guide is None or exemplar_guide is None:
        raise DataError("a guide requires two maps: one of the target and one of the exemplar")
    own = _checked_map("guide of the exemplar", exemplar_guide, exemplar_mask)
    aim = _checked_map("guide of the target", guide, mask)
    spread = float(own[exemplar_mask].std(dtype=np.float64))
    if spread <= 1e-6 * float(np.abs(own[exemplar_mask]).max()):
        raise DataError("the guide of the exemplar is the same everywhere, so it guides nothing")
    factor = np.float32(np.sqrt(weight) / spread)
    return aim * factor, own * factor


def _guide_copies(guide: Float32, *, rotate: bool, mirror: bool) -> Float32:
    """Return the guide of an exemplar for its copies, in the order of `prepare_exemplar`."""
    turned = [
        np.rot90(guide, quarter)[:, :: -1 if flip else 1] for quarter, flip in turns(rotate, mirror)
    ]
    return padded(turned, 0).ravel()


def _curvature_direction_deg(shape: NormalMap, patch: int) -> Float32:
    """Return the direction of the largest curvature, smoothed, counter-clockwise from X.

    Directions are averaged as angles of lines, weighted by the difference of the two curvatures,
    so that parts where both are equal, and the direction arbitrary, take that of their
    surroundings. Known everywhere; on a plane it is 0.
    """
    fit = min(max(patch / _FITTED, _LEAST_FIT), _MOST_FIT)
    found = curvature(shape, scale_px=fit)
    first, second = found.principal
    angle = 2 * np.radians(np.where(found.mask, found.direction_deg, 0))
    weight = np.where(found.mask, first - second, 0)
    lines = np.dstack([weight * np.cos(angle), weight * np.sin(angle)]).astype(np.float32)
    sigma = patch / _SMOOTHED
    smooth = cv2.GaussianBlur(lines, (0, 0), sigma, borderType=cv2.BORDER_REFLECT_101)
    degrees: Float32 = (np.degrees(np.arctan2(smooth[..., 1], smooth[..., 0])) / 2).astype(
        np.float32
    )
    return degrees % np.float32(180)
