"""Where the fields of an object are, and what their light and tilt differ by."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from acquisition import DataError
from calibration import EstimateError
from processing.merging.adjustment import FieldPair, adjust, groups_of, matrix_of
from processing.merging.differences import Differences, differences_of, gains_of, tilts_of
from processing.merging.field_rows import FieldRows, Size
from processing.merging.resampling import ends_of, inverse, rectangle_of, shift_of
from processing.registration import register_fields
from processing.registration.feature_matches import FEWEST_MATCHES, Features, features_of, match
from rig import Progress, no_progress, short_repr
from rig.arrays import Float64

# Features for the first look are searched in images of at most this many pixels along a side.
_LOOK_PX: Final = 350
# Scales of the same camera differ by less than this share.
_MOST_SCALE: Final = 0.02
# Pixels by which the first look may be wrong, in those of its images.
_LOOK_ERROR_PX: Final = 3
# Overlaps that are at least this long and wide are registered.
_LEAST_PX: Final = 24


@dataclass(frozen=True, eq=False)
class Placements:
    """Where N fields are in the whole.

    Parameters
    ----------
    matrices
        ``(N, 3, 3)`` from pixels of a field to those of the whole, whose axes are those of the
        first field.
    size
        (height, width) of the whole.
    gains
        ``(N,)`` factors for the albedo of each field, with the geometric mean 1.
    tilts
        ``(N, 3)`` rotation vectors in radians that turn the normals of each field, after the
        turn in the plane; 0 if the overlaps do not show any.
    pairs
        The pairs that were used.
    residuals_px, deviations
        Distance of the ends of each pair after the adjustment, and its root mean square in standard
        deviations.
    disagreements
        Root mean square difference of the normals of each pair in their standard deviations; NaN
        without standard deviations.
    rejected
        Pairs that contradict the others, and were not used.
    """

    matrices: Float64
    size: tuple[int, int]
    gains: Float64
    tilts: Float64
    pairs: tuple[FieldPair, ...]
    residuals_px: tuple[float, ...]
    deviations: tuple[float, ...]
    disagreements: tuple[float, ...]
    rejected: tuple[FieldPair, ...]

    __repr__ = short_repr

    @property
    def residual_px(self) -> float:
        """Root mean square of ``residuals_px``."""
        return float(np.sqrt(np.mean(np.square(self.residuals_px))))

    @property
    def turns_deg(self) -> Float64:
        """``(N,)`` angles by which the fields are turned, in degrees from right to down."""
        return np.degrees(np.arctan2(self.matrices[:, 1, 0], self.matrices[:, 0, 0]))


def place_fields(fields: Sequence[FieldRows], on_progress: Progress = no_progress) -> Placements:
    """Find where overlapping fields of one object are.

    Pairs that overlap are found by features, and registered by `register_fields` of
    `processing.registration`. All placements are adjusted together; pairs that contradict the
    others are left out. Differences in the overlaps give the gain of the albedo, and the tilt of
    each field if it is significant.

    Parameters
    ----------
    fields
        At least two fields of the same scale, in any order, moved and turned in the plane.
    on_progress
        Receives the stages ``looking for overlaps`` and ``registering fields``.

    Raises
    ------
    DataError
        If there is one field only, or the scales differ.
    EstimateError
        If fields do not overlap with the others; the message names them.

    Examples
    --------
    >>> from processing.merging import place_fields
    >>> place_fields([])
    Traceback (most recent call last):
    ...
    acquisition._errors.DataError: 0 fields: give at least two fields that overlap
    """
    if len(fields) < 2:
        given = f"{len(fields)} field{'' if len(fields) == 1 else 's'}"
        raise DataError(f"{given}: give at least two fields that overlap")
    looks = _looks(fields, on_progress)
    todo = _first_look(fields, looks)
    registered, differences = list[FieldPair](), list[Differences]()
    tried = set[tuple[int, int]]()
    while True:
        for number, (ends, start) in enumerate(sorted(todo.items())):
            on_progress("registering fields", number, len(todo))
            found = _registered(fields, ends, start)
            if found is not None:
                registered.append(found[0])
                differences.append(found[1])
        on_progress("registering fields", len(todo), len(todo))
        tried |= set(todo)
        _check_connected(fields, registered, looks)
        adjusted = adjust(len(fields), registered)
        overlaps = _overlaps(fields, adjusted.placements)
        todo = {ends: start for ends, start in overlaps.items() if ends not in tried}
        if not todo:
            break
    used = sorted(adjusted.deviations)
    pairs = [registered[k] for k in used]
    known = [differences[k] for k in used]
    matrices, size = _whole(fields, adjusted.placements)
    turns = adjusted.placements[:, 2]
    commons = [field.common_sigma_deg for field in fields]
    return Placements(
        matrices,
        size,
        gains_of(len(fields), pairs, known),
        tilts_of(turns, pairs, known, np.radians(commons)),
        tuple(pairs),
        tuple(adjusted.residuals_px[k] for k in used),
        tuple(adjusted.deviations[k] for k in used),
        tuple(one.disagreement for one in known),
        tuple(registered[k] for k in adjusted.rejected),
    )


def _looks(fields: Sequence[FieldRows], on_progress: Progress) -> list[Features]:
    """Return features of reduced fields."""
    looks = []
    for number, field in enumerate(fields):
        on_progress("looking for overlaps", number, len(fields))
        looks.append(_look(field))
    on_progress("looking for overlaps", len(fields), len(fields))
    return looks


def _look(field: FieldRows, *, mirrored: bool = False) -> Features:
    whole = field.part(slice(0, field.size[0]), slice(0, field.size[1]))
    if whole is None:
        raise DataError(f"{field.name}: has no normals: leave it out")
    return features_of(whole, math.ceil(max(field.size) / _LOOK_PX), mirrored)


def _first_look(
    fields: Sequence[FieldRows], looks: Sequence[Features]
) -> dict[tuple[int, int], Float64]:
    """Return the pairs that seem to overlap, with a rigid start for their registration."""
    starts = {}
    for first, second in itertools.combinations(range(len(fields)), 2):
        found = match(looks[first], looks[second], scale=True)
        if found is None or found.agreeing < FEWEST_MATCHES:
            continue
        scale = math.sqrt(abs(np.linalg.det(found.matrix[:2, :2])))
        if abs(scale - 1) > _MOST_SCALE:
            if found.agreeing >= 3 * FEWEST_MATCHES:
                raise DataError(
                    f"{fields[first].name} and {fields[second].name}: pixels of the second are "
                    f"{1 / scale:.3f} times as large: give fields of the same scale"
                )
            continue
        starts[first, second] = _rigid(found.matrix, fields[first].size, fields[second].size)
    return starts


def _rigid(matrix: Float64, first: Size, second: Size) -> Float64:
    """Return the rigid transform that is equal to a similarity in the middle of the overlap."""
    made = matrix_of(np.array([0, 0, math.atan2(matrix[1, 0], matrix[0, 0])]))
    common = rectangle_of(inverse(matrix), second, first)
    rows, columns = common or (slice(0, first[0]), slice(0, first[1]))
    middle = [(columns.start + columns.stop) / 2, (rows.start + rows.stop) / 2, 1]
    made[:2, 2] = (matrix @ middle - made @ middle)[:2]
    return made


def _registered(
    fields: Sequence[FieldRows], ends: tuple[int, int], start: Float64
) -> tuple[FieldPair, Differences] | None:
    """Return a pair that is registered in the rectangles that the fields have in common."""
    first, second = (fields[k] for k in ends)
    margin = _LOOK_ERROR_PX * math.ceil(max(*first.size, *second.size) / _LOOK_PX)
    here = rectangle_of(inverse(start), second.size, first.size, margin)
    there = rectangle_of(start, first.size, second.size, margin)
    if here is None or there is None:
        return None
    one, other = first.part(*here), second.part(*there)
    if one is None or other is None:
        return None
    into, out_of = shift_of(*here), inverse(shift_of(*there))
    try:
        found = register_fields(one, other, model="rigid", start=out_of @ start @ into)
    except EstimateError:
        return None
    rows, columns = np.nonzero(found.common)
    middle = np.array([columns.mean(), rows.mean()])
    half = math.hypot(columns.std(), rows.std())
    pair = FieldPair(
        *ends,
        inverse(out_of) @ found.matrix @ inverse(into),
        found.covariance,
        middle + np.array([here[1].start, here[0].start]),
        half,
        found.correlation,
        len(rows),
    )
    return pair, differences_of(one, other, found.matrix)


def _check_connected(
    fields: Sequence[FieldRows], pairs: Sequence[FieldPair], looks: Sequence[Features]
) -> None:
    groups = groups_of(len(fields), pairs)
    if len(groups) == 1:
        return
    names = [[fields[k].name for k in group] for group in sorted(groups, key=len, reverse=True)]
    for group in groups:
        if len(group) == 1 and _is_mirrored(fields[group[0]], looks):
            raise EstimateError(
                f"{fields[group[0]].name} is mirrored: what it shows agrees with the mirror images "
                "of the other fields"
            )
    alone = [group[0] for group in names if len(group) == 1]
    if len(alone) == len(fields):
        raise EstimateError(
            f"{', '.join(alone[:-1])} and {alone[-1]} have nothing in common: give overlapping "
            "fields of one object"
        )
    if len(alone) == len(names) - 1:
        shows = "shows" if len(alone) == 1 else "show"
        raise EstimateError(
            f"{', '.join(alone)} {shows} nothing of what the other fields show: leave out what is "
            "foreign, or give a field in between"
        )
    joined = " | ".join(", ".join(group) for group in names)
    raise EstimateError(
        f"the fields form {len(names)} groups that have nothing in common ({joined}): give a field "
        "in between, or merge each group on its own"
    )


def _is_mirrored(field: FieldRows, looks: Sequence[Features]) -> bool:
    """Return whether the mirror image of a field overlaps with another one."""
    mirrored = _look(field, mirrored=True)
    found = (match(mirrored, look, scale=False) for look in looks)
    return any(one is not None and one.agreeing >= FEWEST_MATCHES for one in found)


def _overlaps(fields: Sequence[FieldRows], placements: Float64) -> dict[tuple[int, int], Float64]:
    """Return all pairs that overlap according to placements, with starts."""
    found = {}
    matrices = [matrix_of(one) for one in placements]
    for first, second in itertools.combinations(range(len(fields)), 2):
        start = inverse(matrices[second]) @ matrices[first]
        here = rectangle_of(inverse(start), fields[second].size, fields[first].size)
        there = rectangle_of(start, fields[first].size, fields[second].size)
        if here is None or there is None:
            continue
        if min(part.stop - part.start for part in (*here, *there)) >= _LEAST_PX:
            found[first, second] = start
    return found


def _whole(fields: Sequence[FieldRows], placements: Float64) -> tuple[Float64, tuple[int, int]]:
    """Return matrices into the pixels of the whole, and its size."""
    matrices = np.array([matrix_of(one) for one in placements])
    ends = [ends_of(one, field.size) for one, field in zip(matrices, fields, strict=True)]
    # Whole pixels: the first field keeps its own ones. A field shows those to half a pixel around.
    left, top = (round(min(float(one[axis].min()) for one in ends)) for axis in (0, 1))
    right, bottom = (round(max(float(one[axis].max()) for one in ends)) for axis in (0, 1))
    matrices[:, 0, 2] -= left
    matrices[:, 1, 2] -= top
    return matrices, (bottom - top + 1, right - left + 1)
