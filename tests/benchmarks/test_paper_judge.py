"""The measures that compare mesh methods and the normal domain under equal conditions."""

from __future__ import annotations

import numpy as np
import pytest

from acquisition import angle_deg
from benchmarks.paper.judge import AS_SURFACES, FLOOR, PLAIN, SAME_SURFACES, judge
from benchmarks.paper.measure import IN_NORMALS
from benchmarks.paper.peers.surfaces import Surfaces
from processing import NormalMap

SIDE = 48


def from_slopes(x_slope: np.ndarray, y_slope: np.ndarray) -> NormalMap:
    return NormalMap.from_vectors(np.stack([-x_slope, -y_slope, np.ones_like(x_slope)], axis=2))


ROWS, COLUMNS = np.mgrid[:SIDE, :SIDE].astype(np.float64)
FLAT = from_slopes(0 * COLUMNS, 0 * COLUMNS)
RELIEF = from_slopes(0.3 * np.cos(COLUMNS * 2 * np.pi / 6), 0.3 * np.sin(ROWS * 2 * np.pi / 7))
DOME = from_slopes(-(COLUMNS - 24) / 60, (ROWS - 24) / 60)


@pytest.mark.parametrize("period", [4, 6, 12, 40])
def test_a_round_trip_loses_as_much_as_two_means_over_pixels(period):
    """An edge has a mean of four slopes, weights -1, 13, 13, -1; a vertex one of two steps."""
    slope = 0.01 * np.sin(COLUMNS * 2 * np.pi / period)
    given = from_slopes(slope, 0 * slope)
    read = Surfaces.of(given, FLAT).round_trip(given)
    found = -read.normals[..., 0] / read.normals[..., 2]
    inner = (slice(2, -2), slice(2, -2))
    half = np.pi / period
    expected = slope * np.cos(half) * (13 * np.cos(half) - np.cos(3 * half)) / 12
    np.testing.assert_allclose(found[inner], expected[inner], atol=2e-6)


def test_a_round_trip_of_a_plane_changes_nothing():
    plane = from_slopes(0.4 + 0 * ROWS, -0.7 + 0 * ROWS)
    read = Surfaces.of(plane, plane).round_trip(plane)
    assert angle_deg(read.normals, plane.normals).max() < 0.01


def test_no_face_joins_two_parts_of_the_source():
    """The ridge between two tilted halves is too sharp, so their relative height is unknown."""
    slope = np.where(COLUMNS < 24, 0.5, -0.2)
    slope[:, 23], slope[:, 24] = -3, 3
    source = from_slopes(slope, 0 * slope)
    surfaces = Surfaces.of(source, FLAT)
    columns = surfaces.mesh.faces % SIDE
    assert not ((columns <= 23).any(axis=1) & (columns >= 24).any(axis=1)).any()
    # On both sides, the normals of the planes are unchanged.
    read = surfaces.round_trip(source)
    planes = np.abs(COLUMNS - 23.5) > 2
    assert angle_deg(read.normals, source.normals)[planes].max() < 0.01


def test_pixels_without_a_face_keep_their_normals():
    normals = FLAT.normals.copy()
    normals[:, 24] = (0, 0, -1)
    source = NormalMap(normals, FLAT.mask)
    surfaces = Surfaces.of(source, FLAT)
    np.testing.assert_array_equal(surfaces.round_trip(source).normals, normals)
    np.testing.assert_array_equal(
        surfaces.read(surfaces.source, DOME).normals[:, 24], DOME.normals[:, 24]
    )


def test_a_perfect_mesh_transfer_has_only_the_error_of_the_floor():
    """Detail of a surface is transferred to itself, by a method that returns the surface."""
    surfaces = Surfaces.of(RELIEF, RELIEF)
    perfect = surfaces.read(surfaces.source, RELIEF)
    judged = judge({"mesh": perfect}, RELIEF, RELIEF, {})
    for name in PLAIN:
        assert judged[name]["mesh"] == pytest.approx(judged[name][FLOOR])
    assert judged["detail error, deg"][FLOOR] > 2
    for name in (*SAME_SURFACES, *AS_SURFACES):
        assert judged[name]["mesh"] == pytest.approx(0, abs=1e-3)


def test_a_perfect_transfer_of_normals_has_no_error():
    judged = judge({"normals": RELIEF}, RELIEF, RELIEF, IN_NORMALS)
    for name in (*PLAIN[::2], *SAME_SURFACES, *AS_SURFACES):
        assert judged[name]["normals"] == pytest.approx(0, abs=1e-3), name
    for name in PLAIN[1::2]:
        assert judged[name]["normals"] == pytest.approx(1, abs=1e-5)


def test_a_missing_transfer_is_measured_by_every_measure():
    """The unchanged target has no detail: each measure returns about the missing detail."""
    missing = float(angle_deg(RELIEF.normals, (0, 0, 1)).mean())
    for in_normals in ({}, {"nothing": lambda _, target: target}):
        judged = judge({"nothing": DOME}, RELIEF, DOME, in_normals)
        for name in ("detail error, deg", SAME_SURFACES[1], AS_SURFACES[1]):
            # Computed from a surface, slopes of this relief are a fifth to a quarter lower.
            assert 0.7 * missing < judged[name]["nothing"] < 1.05 * missing, name


def test_a_result_that_is_not_integrable_is_measured_as_its_integrated_surface():
    """Rotational slopes are not integrable: the nearest surface is flat."""
    disc = np.hypot(ROWS - 23.5, COLUMNS - 23.5) < 20
    curl, flat = (
        NormalMap(np.where(disc[..., None], one.normals, 0), disc)
        for one in (from_slopes(0.02 * (23.5 - ROWS), 0.02 * (23.5 - COLUMNS)), FLAT)
    )
    judged = judge({"normals": curl}, flat, flat, {"normals": lambda _, target: target})
    assert judged["shape error, deg"]["normals"] > 10
    assert judged[AS_SURFACES[0]]["normals"] < 2
    # From the same surfaces, this method returns the target.
    assert judged[SAME_SURFACES[0]]["normals"] < 1e-3


def test_only_the_region_counts():
    region = (np.hypot(ROWS - 24, COLUMNS - 24) < 9).astype(np.bool_)
    wrong = NormalMap(np.where(region[..., None], RELIEF.normals, DOME.normals), RELIEF.mask)
    everywhere = judge({"half": wrong}, RELIEF, RELIEF, {})
    inside = judge({"half": wrong}, RELIEF, RELIEF, {}, region=region)
    assert inside["detail error, deg"]["half"] < 0.3 * everywhere["detail error, deg"]["half"]


def test_pixels_without_a_source_use_the_target():
    cut = RELIEF.mask & (COLUMNS < 30)
    source = NormalMap(np.where(cut[..., None], RELIEF.normals, 0), cut)
    region = cut & (COLUMNS > 12) & (COLUMNS < 20)
    judged = judge({"target": DOME}, source, DOME, {}, region=region)
    assert all(np.isfinite(figure) for by in judged.values() for figure in by.values())
