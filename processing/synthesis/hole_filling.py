"""Filling of holes in normal maps: a continued shape with detail of the surroundings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from acquisition import DataError
from processing.detail.rotation import rotate_from_z, rotate_to_z
from processing.detail.seam import SeamSteps, seam_steps
from processing.detail.shape_filter import ShapeFilter
from processing.maps.mask import bounding_box
from processing.maps.normal_map import NormalMap, check_mask, check_normal_map
from processing.surface.multigrid import coarsened, solve
from processing.synthesis.exemplar import mean_angle
from processing.synthesis.hole_detail import fill_detail
from processing.synthesis.quilting import check_options
from rig import Progress, no_progress, pluralize
from rig.arrays import Bool, Float32

_TOLERANCE = 1e-7
# The filter at the rim sees the continued shape; this often the shape is continued again.
_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class FilledHoles:
    """A normal map without holes; its figures are computed on demand.

    Parameters
    ----------
    normal_map
        The map, known over its mask and the holes. Outside the holes it has not changed.
    holes
        ``(H, W)`` bool, the pixels that were invented.
    surroundings
        ``(H, W)`` bool, the pixels whose detail was used.
    shape, detail
        Its components; their combination is the map.
    patch, overlap
        Side of the patches and width of their overlap in pixels.
    """

    normal_map: NormalMap
    holes: Bool
    surroundings: Bool
    shape: NormalMap
    detail: NormalMap
    patch: int
    overlap: int

    def __repr__(self) -> str:
        pixels = pluralize(int(np.count_nonzero(self.holes)), "pixel")
        return f"FilledHoles({self.normal_map!r}, holes of {pixels})"

    @cached_property
    def seam(self) -> SeamSteps:
        """Angular steps across the rims of the holes and inside them."""
        return seam_steps(self.normal_map, self.holes)

    @cached_property
    def detail_angle_deg(self) -> float:
        """Mean angle between the detail and z in the holes."""
        return math.degrees(mean_angle(self.detail.normals[self.holes]))

    @cached_property
    def surroundings_angle_deg(self) -> float:
        """The same in the surroundings."""
        return math.degrees(mean_angle(self.detail.normals[self.surroundings]))


def fill_holes(
    normal_map: NormalMap,
    holes: Bool,
    *,
    patch: int = 12,
    overlap: int | None = None,
    seed: int = 0,
    shape_filter: ShapeFilter = ShapeFilter(),
    on_progress: Progress = no_progress,
) -> FilledHoles:
    """Fill damaged or missing parts of a normal map from their surroundings.

    The shape is continued smoothly: n_x and n_y are harmonic functions inside a hole. The detail is
    quilted from patches of the surroundings that continue what is known (Efros and Freeman, *Image
    Quilting for Texture Synthesis and Transfer*, 2001). What still differs at the rim decays within
    about `w` pixels, as in `transfer_local`.

    Parameters
    ----------
    normal_map
        The map. Its normals inside the holes are ignored.
    holes
        ``(H, W)`` bool, the pixels to fill. Pixels outside the mask are added to it.
    patch
        Side of the square patches in pixels, at least 6.
    overlap
        Width of the known part that patches continue in pixels, 2 to a third of the patch. Default:
        a third of the patch.
    seed
        Fixes all random choices, 0 to 2^63 - 1.
    shape_filter
        The filter that separates shape and detail.
    on_progress
        Receives the stage ``filling``: the number of pixels in holes.

    Returns
    -------
    FilledHoles
        The map with its parts, and figures on demand.

    Raises
    ------
    DataError
        If the holes have another size, are empty or larger than what surrounds them; if one touches
        no normal, or no patch fits into its surroundings; if a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from processing import NormalMap, angular_error, fill_holes
    >>> y, x = np.mgrid[1:-1:96j, -1:1:96j]
    >>> ball = NormalMap.from_vectors(np.dstack([x, y, np.sqrt(2.5 - x**2 - y**2)]))
    >>> filled = fill_holes(ball, x**2 + y**2 < 0.1)
    >>> angular_error(filled.normal_map, ball).mae_deg < 0.5
    True
    """
    check_normal_map("normal_map", normal_map)
    overlap = max(patch // 3, 2) if overlap is None else overlap
    known = _checked(normal_map, holes, patch, overlap, seed)
    given = NormalMap(np.where(known[..., None], normal_map.normals, 0), known)
    on_progress("filling", 0, int(np.count_nonzero(holes)))
    shape = _continued_shape(given, holes, shape_filter)
    everything = known | holes
    detail = NormalMap(np.where(known[..., None], rotate_to_z(given.normals, shape), 0), known)
    vectors, used = fill_detail(
        detail,
        holes,
        patch=patch,
        overlap=overlap,
        seed=seed,
        blend_px=shape_filter.w,
        on_progress=on_progress,
    )
    normals = np.where(holes[..., None], rotate_from_z(vectors, shape), given.normals)
    return FilledHoles(
        NormalMap(normals, everything),
        holes,
        used,
        NormalMap(shape, everything),
        NormalMap(vectors, everything),
        patch,
        overlap,
    )


def _checked(normal_map: NormalMap, holes: Bool, patch: int, overlap: int, seed: int) -> Bool:
    """Check the arguments and return where normals are known."""
    holes = check_mask("holes", holes, normal_map.size)
    count, known = int(np.count_nonzero(holes)), normal_map.mask & ~holes
    left = int(np.count_nonzero(known))
    if not count:
        raise DataError("the mask of holes is empty: there is nothing to fill")
    if not left:
        raise DataError("the mask of holes covers every normal: nothing is left to fill it from")
    if count > left:
        raise DataError(
            f"the holes have {count} pixels, more than the {left} normals that are left: too few "
            "to continue"
        )
    check_options(patch, overlap, seed)
    touched = cv2.dilate(known.astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
    _, labels = cv2.connectedComponents(holes.astype(np.uint8), connectivity=4)
    alone = holes & ~np.isin(labels, labels[holes & (touched > 0)])
    if alone.any():
        row, column = (int(values[0]) for values in np.nonzero(alone))
        raise DataError(
            f"the hole at column {column}, row {row} touches no normal: there is nothing to "
            "continue into it"
        )
    return known


def _continued_shape(given: NormalMap, holes: Bool, shape_filter: ShapeFilter) -> Float32:
    """Return the shape component, continued into the holes."""
    shape = _harmonic_normals(shape_filter.shape(given).normals, given.mask, holes)
    for _ in range(_ROUNDS):
        whole = np.where(holes[..., None], shape, given.normals)
        around = shape_filter.shape(NormalMap(whole, given.mask | holes)).normals
        shape = _harmonic_normals(around, given.mask, holes)
    return shape


def _harmonic_normals(normals: Float32, known: Bool, holes: Bool) -> Float32:
    """Continue unit vectors into holes, n_x and n_y as harmonic functions.

    Both solve Laplace's equation with the known vectors around the holes; where a hole meets pixels
    that are neither known nor in a hole, its border is free. The vectors of a sphere are continued
    exactly, because its n_x and n_y are linear functions of x and y. n_z is positive.

    Parameters
    ----------
    normals
        ``(H, W, 3)`` float32 unit vectors.
    known, holes
        ``(H, W)`` bool, without common pixels. Every connected part of the holes touches a known
        pixel.

    Returns
    -------
    Float
        ``(H, W, 3)`` float32: `normals`, with unit vectors in the holes.
    """
    rows, columns = (slice(max(part.start - 1, 0), part.stop + 1) for part in bounding_box(holes))
    box = rows, columns
    inside, given = np.pad(holes[box], 1), np.pad(known[box], 1)
    right, down = np.zeros(inside.shape, np.float32), np.zeros(inside.shape, np.float32)
    right[:, :-1] = inside[:, :-1] & inside[:, 1:]
    down[:-1] = inside[:-1] & inside[1:]
    fixed = np.pad(np.where(known[box][..., None], normals[box], 0), ((1, 1), (1, 1), (0, 0)))
    anchors, sums = np.zeros(inside.shape, np.float32), np.zeros((*inside.shape, 2))
    for axis, step in ((0, 1), (0, -1), (1, 1), (1, -1)):
        anchors += np.roll(given, step, axis) & inside
        sums += np.roll(fixed[..., :2], step, axis) * inside[..., None]
    levels = coarsened(right, down, anchors)
    found = [
        solve(right, down, sums[..., k], anchors=anchors, levels=levels, tolerance=_TOLERANCE).u
        for k in (0, 1)
    ]
    x, y = (part[1:-1, 1:-1] for part in found)
    z = np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    vectors = np.dstack([x, y, z])
    vectors /= np.maximum(np.linalg.norm(vectors, axis=2, keepdims=True), 1e-30)
    continued = normals.copy()
    continued[holes] = vectors[holes[box]]
    return continued
