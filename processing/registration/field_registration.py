"""Registration of two fields: where the pixels of one are in the other, and how sure this is."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from calibration import EstimateError
from processing.maps.normal_map import NormalMap
from processing.registration.feature_matches import FEWEST_MATCHES, features_of, match
from processing.registration.field import Field, fine, reduced
from processing.registration.normal_rotation import rotation_between
from processing.registration.placement_fit import (
    INTERPOLATION_PX,
    SMOOTH_PX,
    Comparison,
    PlacementFit,
    Target,
    fit_placement,
)
from processing.registration.plane_transform import PlaneModel, transformed, turn_of
from processing.registration.residual_drift import Drift, fit_drift
from rig import short_repr
from rig.arrays import Bool, Float32, Float64

# Smallest image along a side in which features are searched, and in which a placement is fitted.
_FEWEST_PX: Final = 60
# Size of the tiles that show where the registration holds; the fewest known pixels of one.
_TILE_PX: Final = 64
_FEWEST_KNOWN: Final = 0.25
_SIMILAR: Final = 0.5
_FEWEST_COMMON: Final = 2000
# A tilt is linear only if it is small.
_TILT_STEPS: Final = 4
_MOST_POSITIONS: Final = 10_000


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the pixels of a first field are in a second one.

    Parameters
    ----------
    matrix
        ``(3, 3)`` from pixels ``(column, row, 1)`` of the first field to those of the second.
    rotation
        ``(3, 3)``, turns normals of the first field into the frame of the second: the turn of the
        matrix in the plane, and the tilt that the normals show.
    covariance
        ``(P, P)`` covariance of the parameters of the model (right, down, turn, and further ones),
        in pixels of the first field at the border of the common area.
    sigma_px
        Standard deviation of a position, root mean square over the common area.
    correlation
        Correlation of the fine structure in the common area: 1 without noise.
    common
        ``(H, W)`` bool, the pixels of the first field that the second shows.
    holds
        ``(H, W)`` bool, those of them around which the fine structure of both is alike or absent.
    drift
        Smooth shifts in addition to the matrix, such as the parallax of a relief; None if they were
        not estimated, or are not significant.
    """

    matrix: Float64
    rotation: Float64
    covariance: Float64
    sigma_px: float
    correlation: float
    common: Bool
    holds: Bool
    drift: Drift | None = None

    __repr__ = short_repr

    @property
    def turn_deg(self) -> float:
        """By how much the second field is turned in the plane, counterclockwise as seen."""
        rows, columns = np.nonzero(self.common)
        return -math.degrees(turn_of(self.matrix, float(columns.mean()), float(rows.mean())))

    @property
    def enlargement(self) -> float:
        """Pixels of the second field per pixel of the first, at the middle of the common area."""
        rows, columns = np.nonzero(self.common)
        x = float(columns.mean()) + np.array([0.0, 1.0, 0.0])
        y = float(rows.mean()) + np.array([0.0, 0.0, 1.0])
        right, down = transformed(self.matrix, x, y)
        across, along = (np.array([one[k] - one[0] for one in (right, down)]) for k in (1, 2))
        return math.sqrt(abs(float(across[0] * along[1] - across[1] * along[0])))

    def at(self, columns: Float64, rows: Float64) -> tuple[Float64, Float64]:
        """Return columns and rows in the second field of positions in the first."""
        if self.drift is not None:
            right, down = self.drift.at(columns, rows)
            columns, rows = columns + right, rows + down
        return transformed(self.matrix, columns, rows)

    def resampled(self, second: Field) -> Field:
        """Return the second field on the pixels of the first, with normals in the first's frame.

        Values are interpolated by cubic splines; error bars are those of the nearest pixel.
        """
        height, width = self.common.shape
        rows, columns = np.mgrid[:height, :width].astype(np.float64)
        x, y = self.at(columns, rows)
        where = np.stack([y, x])
        inside = self.common

        def between(values: Float32) -> Float32:
            known = np.isfinite(values)
            filled = np.where(known, values, np.float32(np.median(values[known])))
            made = map_coordinates(filled, where, order=3, mode="mirror", output=np.float32)
            return np.where(inside, made, np.float32(np.nan))

        def nearest(values: Float32 | None) -> Float32 | None:
            if values is None:
                return None
            made = map_coordinates(values, where, order=0, cval=np.nan, output=np.float32)
            return np.where(inside, made, np.float32(np.nan))

        seen = np.where(second.mask[..., None], second.normal_map.normals, np.float32(0))
        vectors = np.dstack([between(seen[..., k]) for k in range(3)]) @ self.rotation
        vectors = np.where(inside[..., None], vectors, 0)
        length = np.linalg.norm(vectors, axis=2, keepdims=True)
        made = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
        return Field(
            NormalMap(made.astype(np.float32), inside & (length[..., 0] > 0)),
            None if second.albedo is None else between(second.albedo),
            nearest(second.sigma_deg),
            nearest(second.common_sigma_deg),
        )


def register_fields(
    first: Field,
    second: Field,
    *,
    model: PlaneModel = "similarity",
    start: Float64 | None = None,
    drift: bool = False,
) -> Registration:
    """Find where the pixels of a field are in another field of the same object.

    Features of curvature and albedo give a first placement, at any turn in the plane. Fine
    structure of slopes and albedo, which does not depend on the lights, is then aligned from coarse
    to fine. Normals turn with the object.

    Parameters
    ----------
    first, second
        The fields.
    model
        ``rigid``: both have the same scale; ``similarity``; ``affine``; ``homography``, also for an
        object that was tilted, or another lens.
    start
        ``(3, 3)`` first placement; default: by features.
    drift
        Whether smooth shifts that the model leaves are estimated, too.

    Raises
    ------
    EstimateError
        If the fields have nothing or too little in common, or one is mirrored.

    Examples
    --------
    >>> import cv2, numpy as np
    >>> from processing import NormalMap
    >>> from processing.registration import Field, register_fields
    >>> noise = np.random.default_rng(1).normal(size=(200, 240, 2)).astype(np.float32)
    >>> slopes = 4 * cv2.GaussianBlur(noise, (0, 0), 3)
    >>> def field(part):
    ...     vectors = np.dstack([part, np.ones(part.shape[:2])])
    ...     return Field(NormalMap.from_vectors(vectors))
    >>> found = register_fields(field(slopes[:, 40:]), field(slopes[:, :200]))
    >>> [round(float(value), 2) for value in found.at(np.array([0.0]), np.array([0.0]))[0]]
    [40.0]
    """
    matrix = _by_features(first, second, model) if start is None else np.array(start, np.float64)
    if model == "rigid":
        matrix[:2, :2] /= math.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    made = _coarse_to_fine(first, second, matrix, model)
    if made is None or not made.fit.credible:
        raise EstimateError(
            "the two fields have too little in common: their fine structure differs where they "
            "overlap"
        )
    fit, size = made.fit, first.mask.shape
    shifts = fit_drift(made.compared, made.target, fit, size) if drift else None
    common = _common(first, second, fit.matrix)
    if np.count_nonzero(common) < _FEWEST_COMMON:
        raise EstimateError(
            f"the two fields have {np.count_nonzero(common)} pixels in common: at least "
            f"{_FEWEST_COMMON} are needed"
        )
    rows, columns = np.nonzero(common)
    every = max(1, len(rows) // _MOST_POSITIONS)
    sigma = fit.sigma_px(np.asarray(columns[::every], float), np.asarray(rows[::every], float))
    turn = turn_of(fit.matrix, *fit.middle)
    c, s = math.cos(turn), math.sin(turn)
    in_plane = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    plain = Registration(
        fit.matrix,
        in_plane,
        fit.covariance,
        math.sqrt(
            float(np.square(sigma).mean())
            + INTERPOLATION_PX**2
            + (0 if shifts is None else shifts.sigma_px**2)
        ),
        fit.correlation,
        common,
        common,
        shifts,
    )
    there = plain.resampled(second)
    tilted = replace(plain, rotation=in_plane @ _tilt(first, there))
    return replace(tilted, holds=common & _alike(first, there))


def _by_features(first: Field, second: Field, model: PlaneModel) -> Float64:
    """Return a first placement by features, from small to large ones."""
    scale = model != "rigid"
    here, there = features_of(first), features_of(second)
    smallest = min(first.mask.shape + second.mask.shape)
    while True:
        found = match(here, there, scale=scale)
        if found is not None and found.agreeing >= FEWEST_MATCHES:
            return found.matrix
        reflected = match(here, features_of(second, there.size, mirrored=True), scale=scale)
        if reflected is not None and reflected.agreeing >= FEWEST_MATCHES:
            raise EstimateError(
                "one of the two fields is mirrored: their fine structure agrees only with the "
                "mirror image"
            )
        size = 2 * max(here.size, there.size)
        if smallest / size < _FEWEST_PX:
            raise EstimateError(
                "the two fields have nothing in common that can be recognized: they show different "
                "objects, overlap too little, or have too little structure"
            )
        here, there = features_of(first, size), features_of(second, size)


class _Fitted(NamedTuple):
    fit: PlacementFit
    compared: Comparison
    target: Target


def _coarse_to_fine(
    first: Field, second: Field, matrix: Float64, model: PlaneModel
) -> _Fitted | None:
    """Fit the placement in reduced images, and then in the images."""
    smallest = min(first.mask.shape + second.mask.shape)
    size = 4
    while size > 1 and smallest / size < _FEWEST_PX:
        size //= 2
    while True:
        middle = (size - 1) / 2
        enlarge = np.array([[size, 0, middle], [0, size, middle], [0, 0, 1.0]])
        shrink = np.linalg.inv(enlarge)
        target = Target(reduced(second.structure, size))
        start = shrink @ matrix @ enlarge
        compared = Comparison.of(reduced(first.structure, size), target, start)
        fit = None if compared is None else fit_placement(compared, target, start, model)
        if fit is not None:
            matrix = enlarge @ fit.matrix @ shrink
        if size == 1:
            if compared is None or fit is None:
                return None
            return _Fitted(fit, compared, target)
        size //= 2


def _common(first: Field, second: Field, matrix: Float64) -> Bool:
    """Return the pixels of the first field whose surroundings the second shows."""
    height, width = first.mask.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    x, y = transformed(matrix, columns, rows)
    # Two pixels around each are used by the interpolation.
    inner = cv2.erode(second.mask.astype(np.uint8), np.ones((5, 5), np.uint8), borderValue=0)
    seen = map_coordinates(inner, np.stack([y, x]), order=0, cval=0) > 0
    return np.asarray(first.mask & seen)


def _tilt(first: Field, there: Field) -> Float64:
    """Return the rotation about axes in the plane from normals of the first to the second."""
    both = first.mask & there.mask
    here, seen = (one.normal_map.normals[both].astype(np.float64) for one in (first, there))
    total = np.eye(3)
    for _ in range(_TILT_STEPS):
        # The images show the turn in the plane more accurately.
        small = rotation_between(here @ total.T, seen)[0] * [1, 1, 0]
        total = cv2.Rodrigues(small)[0] @ total
    return np.asarray(total, np.float64)


def _alike(first: Field, there: Field) -> Bool:
    """Return where the fine structure of both fields is alike or too weak to judge, by tiles."""
    height, width = first.mask.shape
    both = np.isfinite(first.structure).all(axis=0) & np.isfinite(there.structure).all(axis=0)
    count = min(len(first.structure), len(there.structure))
    here, seen = (
        np.where(both, fine(one.structure[:count], SMOOTH_PX), np.float32(0))
        for one in (first, there)
    )
    scale = np.square(here).sum(axis=(1, 2)) + np.square(seen).sum(axis=(1, 2)) + 1e-12
    tops, lefts = (range(0, length, _TILE_PX) for length in (height, width))

    def sums(values: Float32) -> Float64:
        whole = (values / scale[:, None, None]).sum(axis=0, dtype=np.float64)
        return np.asarray(np.add.reduceat(np.add.reduceat(whole, tops, axis=0), lefts, axis=1))

    known = np.add.reduceat(np.add.reduceat(both.astype(int), tops, axis=0), lefts, axis=1)
    enough = known > _FEWEST_KNOWN * _TILE_PX**2
    energy, left = sums(np.square(here) + np.square(seen)), sums(np.square(seen - here))
    usual = float(np.median((left / np.maximum(known, 1))[enough])) if enough.any() else 0.0
    differs = (left > _SIMILAR * energy) & (left > 3 * usual * known)
    alike = np.repeat(np.repeat(~differs, _TILE_PX, axis=0), _TILE_PX, axis=1)
    return np.asarray(alike[:height, :width])
