"""Synthesis of a detail component over the mask of a target, following its surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from processing._normal_map import NormalMap, check_normal_map
from processing._synthesis.exemplar import Exemplar, prepare_exemplar
from processing._synthesis.footprint_search import Places
from processing._synthesis.guidance import (
    checked_map,
    checked_scale,
    curvature_direction_deg,
    guide_copies,
    guide_pair,
)
from processing._synthesis.pattern_field import PatternField, pattern_field
from processing._synthesis.quilting import (
    BALANCE,
    CANDIDATES,
    check_options,
    diagonals,
    positions,
)
from processing._synthesis.seam_steps import CutSteps, cut_steps
from processing._synthesis.warped_kernels import place_warped
from rig import Progress, in_threads, no_progress

Float = npt.NDArray[np.float32]
Bytes = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


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
    labels: Bytes
    patch: int
    overlap: int
    compressed: float

    def __repr__(self) -> str:
        used = f"patch={self.patch}, overlap={self.overlap}, compressed={self.compressed:.3f}"
        return f"TargetSynthesis({self.detail!r}, {used})"

    @cached_property
    def steps(self) -> CutSteps:
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
    overlap = max(patch // 4, 2) if overlap is None else overlap
    check_options(patch, overlap, seed)
    on_progress("preparing", 0, 1)
    pair = guide_pair(guide, exemplar_guide, guide_weight, shape.mask, exemplar.mask)
    window = _bounding_box(shape.mask)
    mask = shape.mask[window]
    part = NormalMap.of_unit_vectors(shape.normals[window], mask)
    turned = None
    if isinstance(direction_deg, str):
        turned = curvature_direction_deg(part, patch)
    elif direction_deg is not None:
        turned = checked_map("direction map", direction_deg, shape.mask)[window]
    sizes = None if scale is None else checked_scale(scale, shape.mask)[window]
    field = pattern_field(part, image_space=image_space, direction_deg=turned, scale=sizes)
    made = prepare_exemplar(exemplar, patch, rotate=rotate, mirror=mirror)
    places, aim = _places(made), np.zeros((0, 0), np.float32)
    if pair is not None:
        aim = pair[0][window]
        places = places._replace(guide=guide_copies(pair[1], rotate=rotate, mirror=mirror))
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
    outside = np.all(exemplar.vectors == 0, axis=-1)
    holes = np.zeros(tuple(np.add(outside.shape, (0, 1, 1))), np.int32)
    holes[:, 1:, 1:] = np.cumsum(np.cumsum(outside, axis=1, dtype=np.int32), axis=2)
    slopes, penalty = exemplar.slopes.reshape(-1, 2), np.ones(len(exemplar.shares))
    return Places(
        exemplar.vectors, slopes, exemplar.classes, exemplar.starts, holes, penalty,
        exemplar.mean_energy, np.zeros(0, np.float32),
    )  # fmt: skip


def _bounding_box(mask: Mask) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)


def _fill(
    field: PatternField,
    mask: Mask,
    guide: Float,
    places: Places,
    shares: npt.NDArray[np.float64],
    patch: int,
    overlap: int,
    seed: int,
    on_progress: Progress,
) -> tuple[Float, Bytes, Mask]:
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
