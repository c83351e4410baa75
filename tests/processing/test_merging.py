"""Overlapping fields of a relief with known heights, joined into one."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from acquisition import DataError, angle_deg
from acquisition.files import MemoryMaps
from benchmarks.relief_fields import Relief, View, relief, seen, true_normals
from calibration import EstimateError
from processing import NormalMap
from processing.merging import (
    FieldPair,
    FieldRows,
    FusionStage,
    MergedField,
    merge_fields,
    place_fields,
)
from processing.merging.adjustment import adjust
from processing.registration import Field
from processing.stages import computed, run_steps
from rig.arrays import Float64
from tests.cases import cases

SIZE = (150, 180)
VIEWS = (
    View(130, 120, 0.03, gain=1.2, sigma_deg=0.6),
    View(255, 115, -0.04, gain=0.8, sigma_deg=1.2),
    View(128, 228, math.pi / 2, sigma_deg=0.9),
    View(250, 222, 3.0, sigma_deg=0.9),
)


@pytest.fixture(scope="module")
def whole() -> Relief:
    return relief((350, 390), 41)


@pytest.fixture(scope="module")
def fields(whole: Relief) -> list[Field]:
    return [seen(whole, view, SIZE, number)[0] for number, view in enumerate(VIEWS)]


@pytest.fixture(scope="module")
def merged(fields: list[Field]) -> MergedField:
    return merge_fields(fields)


@cases(
    ("right", "down"),
    {"to the right": (125, 0), "down, too": (110, 40), "to the left": (-90, 33)},
)
def test_fields_that_are_whole_pixels_apart_have_a_whole_of_their_size(whole, right, down):
    views = View(130, 120, 0.0), View(130 + right, 120 + down, 0.0)
    merged = merge_fields([seen(whole, view, SIZE, number)[0] for number, view in enumerate(views)])
    assert merged.placements.size == (SIZE[0] + abs(down), SIZE[1] + abs(right))
    mask = merged.normal_map.mask
    assert all(end.any() for end in (mask[0], mask[-1], mask[:, 0], mask[:, -1]))


def into_relief(merged: MergedField) -> Float64:
    """Return the matrix from the pixels of the whole to those of the relief."""
    return VIEWS[0].matrix(SIZE) @ np.linalg.inv(merged.placements.matrices[0])


def truth(whole: Relief, merged: MergedField) -> NormalMap:
    """Return the true normals of the whole, in the axes of the first field."""
    height, width = merged.fields.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float64)
    x, y, _ = np.tensordot(into_relief(merged), np.stack([columns, rows, rows * 0 + 1]), 1)
    x, y = (np.clip(at, 0, length - 1) for at, length in ((x, 389), (y, 349)))
    normals = true_normals(whole, x, y)
    cos, sin = math.cos(VIEWS[0].turn), math.sin(VIEWS[0].turn)
    right, up, facing = np.moveaxis(normals, 2, 0)
    return NormalMap.from_vectors(
        np.dstack([cos * right - sin * up, sin * right + cos * up, facing])
    )


def test_fields_are_placed(merged: MergedField) -> None:
    corners = np.array([[0, SIZE[1] - 1, 0], [0, 0, SIZE[0] - 1], [1, 1, 1.0]])
    for view, matrix in zip(VIEWS, merged.placements.matrices, strict=True):
        off = into_relief(merged) @ matrix @ corners - view.matrix(SIZE) @ corners
        assert np.abs(off).max() < 0.15
    assert merged.placements.rejected == ()
    assert len(merged.placements.pairs) >= 4


def test_gains_of_albedo_are_removed(whole: Relief, merged: MergedField) -> None:
    gains = merged.placements.gains * [view.gain for view in VIEWS]
    np.testing.assert_allclose(gains, gains.mean(), rtol=2e-3)
    assert np.prod(merged.placements.gains) == pytest.approx(1)


def test_normals_are_as_good_as_they_say(whole: Relief, merged: MergedField) -> None:
    error = angle_deg(merged.normal_map.normals, truth(whole, merged).normals)
    for count, most in ((1, 1.1), (2, 1.1), (3, 1.1)):
        here = merged.fields == count
        rms, stated = (math.sqrt(np.mean(one[here] ** 2)) for one in (error, merged.sigma_deg))
        assert 0.85 * stated < rms < most * stated
    alone, common = (np.median(merged.sigma_deg[merged.fields == n]) for n in (1, 3))
    assert common < 0.75 * alone


def test_there_are_no_seams(whole: Relief, merged: MergedField) -> None:
    """Where the first field ends, errors on both sides have the same mean."""
    back = np.linalg.inv(merged.placements.matrices[0])
    difference = merged.normal_map.normals - truth(whole, merged).normals
    height, width = merged.fields.shape
    rows, columns = np.mgrid[:height, :width]
    x, y, _ = np.tensordot(back, np.stack([columns, rows, rows * 0 + 1]), 1)
    beside = (y > 5) & (y < SIZE[0] - 6) & (merged.fields > 0)
    inner, outer = (beside & (np.abs(x - SIZE[1] + 1 + at) < 3) for at in (4, -4))
    step = np.degrees(difference[inner].mean(axis=0) - difference[outer].mean(axis=0))
    assert inner.sum() > 500
    assert np.abs(step).max() < 0.15 * np.median(merged.sigma_deg[merged.fields == 1])


def test_a_tilted_field_is_turned_back(whole: Relief) -> None:
    views = [
        replace(view, tilt=(0, 2.0) if number == 1 else (0, 0)) for number, view in enumerate(VIEWS)
    ]
    fields = [seen(whole, view, SIZE, number)[0] for number, view in enumerate(views)]
    tilts = np.degrees(place_fields(rows_of(fields)).tilts)
    assert np.abs(tilts[1] - tilts[0] - [2, 0, 0])[:2].max() < 0.3
    assert np.abs(tilts[[0, 2, 3]] - tilts[[0, 2, 3]].mean(axis=0)).max() < 0.3


def rows_of(fields: list[Field]) -> list[FieldRows]:
    return [FieldRows.of(field, name) for field, name in zip(fields, "ABCDEFGH", strict=False)]


def test_tilts_within_common_errors_are_left(whole: Relief, fields: list[Field]) -> None:
    tilted = [replace(view, tilt=(0, 0.3 * (-1) ** n)) for n, view in enumerate(VIEWS)]
    rows = rows_of([seen(whole, view, SIZE, number)[0] for number, view in enumerate(tilted)])
    assert place_fields(rows).tilts.any()
    uncertain = [replace(one, common_sigma_deg=0.6) for one in rows]
    assert not place_fields(uncertain).tilts.any()


def test_bands_do_not_change_the_result(
    fields: list[Field], merged: MergedField, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = FusionStage(tuple(rows_of(fields)), merged.placements)
    monkeypatch.setattr("processing.merging.fusion._ROWS", 40)
    maps = MemoryMaps(stage.forms())
    run_steps("fusing", stage.steps(maps), maps)
    again = maps["normals"][:]
    assert (angle_deg(again, merged.normal_map.normals)[merged.normal_map.mask] < 0.05).all()
    np.testing.assert_array_equal(maps["fields"][:], merged.fields)


def test_errors_common_to_all_pixels_stay(fields: list[Field], merged: MergedField) -> None:
    rows = tuple(replace(one, common_sigma_deg=0.4) for one in rows_of(fields))
    stage = FusionStage(rows, merged.placements)
    sigma = computed(stage)["normal_sigma_deg"][:]
    assert np.nanmin(sigma) > 0.4 - 1e-4
    assert (sigma >= merged.sigma_deg - 1e-5)[merged.normal_map.mask].all()


def test_a_hole_is_filled_by_another_field(fields: list[Field], merged: MergedField) -> None:
    mask = fields[1].mask.copy()
    mask[60:80, 3:30] = False
    normals = fields[1].normal_map.normals * mask[..., None]
    hole = replace(fields[1], normal_map=NormalMap(normals, mask))
    again = merge_fields([fields[0], hole, *fields[2:]])
    assert again.placements.size == merged.placements.size
    # Pixels at the rim come and go with hundredths of a pixel.
    assert (again.normal_map.mask != merged.normal_map.mask).sum() < 20
    assert (again.fields < merged.fields).sum() > 300


def pair(first: int, second: int, right: float, down: float = 0.0) -> FieldPair:
    matrix = np.array([[1, 0, -right], [0, 1, -down], [0, 0, 1.0]])
    middle = np.array([50.0, 50.0])
    return FieldPair(first, second, matrix, np.eye(3) * 1e-4, middle, 30.0, 0.9, 2000)


def test_a_wrong_pair_is_named() -> None:
    places = {0: (0, 0), 1: (100, 0), 2: (0, 80), 3: (100, 80)}
    right = [
        pair(a, b, places[b][0] - places[a][0], places[b][1] - places[a][1])
        for a, b in ((0, 1), (0, 2), (1, 3), (2, 3))
    ]
    wrong = pair(0, 3, 60, 80)
    found = adjust(4, [wrong, *right])
    assert found.rejected == (0,)
    np.testing.assert_allclose(found.placements[:, :2], list(places.values()), atol=1e-6)


def test_errors_are_spread_over_a_loop() -> None:
    loop = [pair(0, 1, 100), pair(1, 2, 0, 80), pair(0, 2, 100.03, 80)]
    found = adjust(3, loop)
    assert found.rejected == ()
    assert max(found.residuals_px.values()) == pytest.approx(0.01, rel=0.3)


def foreign() -> Field:
    return seen(relief((350, 390), 77), VIEWS[0], SIZE, 9)[0]


def larger(whole: Relief) -> Field:
    """Return a field whose pixels are 5 % smaller."""
    view = View(190, 170, 0)
    field, _ = seen(whole, view, (200, 240), 3)
    grown = [
        cv2.resize(one, None, fx=1.05, fy=1.05, interpolation=cv2.INTER_CUBIC)
        for one in (field.normal_map.normals, field.albedo)
    ]
    return Field(NormalMap.from_vectors(grown[0]), grown[1])


def mirrored(field: Field) -> Field:
    normals = field.normal_map.normals[:, ::-1] * np.float32([-1, 1, 1])
    return Field(NormalMap.from_vectors(normals), np.ascontiguousarray(field.albedo[:, ::-1]))


@cases(
    ("kind", "error", "message"),
    {
        "foreign": ("foreign", EstimateError, "field 4 shows nothing"),
        "mirrored": ("mirrored", EstimateError, "field 4 is mirrored"),
        "one": ("one", DataError, "1 field: give at least two"),
        "two groups": ("groups", EstimateError, "field 0, field 1 | field 2, field 3"),
        "scale": ("scale", DataError, "give fields of the same scale"),
        "none in common": ("none", EstimateError, "nothing in common"),
    },
)
def test_fields_that_do_not_fit(
    whole: Relief, fields: list[Field], kind: str, error: type[Exception], message: str
) -> None:
    other = relief((350, 390), 77)
    given = {
        "foreign": [*fields, foreign()],
        "mirrored": [*fields, mirrored(seen(whole, View(190, 170, 0), SIZE, 9)[0])],
        "one": fields[:1],
        "groups": [*fields[:2], *(seen(other, view, SIZE, 5)[0] for view in VIEWS[:2])],
        "scale": [*fields, larger(whole)],
        "none": [fields[0], foreign()],
    }[kind]
    with pytest.raises(error) as raised:
        merge_fields(given)
    assert message in str(raised.value)
