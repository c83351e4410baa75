"""Polygons that are not convex keep their area, and none is drawn outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.mesh_files import polygons
from acquisition.mesh_files.polygons import triangles_of
from rig import UnreadableError

TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def areas(ring):
    """Return the signed areas of the triangles of one polygon that lies askew in space."""
    points = np.insert(np.asarray(ring, float), 2, 5.0, axis=1) @ TURN.T
    faces, notices = triangles_of(np.array([len(ring)]), np.arange(len(ring)), points)
    a, b, c = (np.asarray(ring, float)[faces[:, corner]] for corner in range(3))
    u, v = b - a, c - a
    return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2, notices


def area_of(ring):
    x, y = np.asarray(ring, float).T
    return (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2


RINGS = {
    "arrow": [(0, 0), (40, 0), (40, 30), (20, 5), (0, 30)],
    "U": [(0, 0), (9, 0), (9, 9), (6, 9), (6, 3), (3, 3), (3, 9), (0, 9)],
    "U with corners on lines": [(0, 0), (4, 0), (9, 0), (9, 9), (6, 9), (6, 6), (6, 3), (3, 3),
                                (3, 9), (0, 9), (0, 4)],
    "square with a hole and a bridge": [(0, 0), (9, 0), (9, 9), (0, 9), (0, 0), (3, 3), (3, 6),
                                        (6, 6), (6, 3), (3, 3)],
}  # fmt: skip


@pytest.mark.parametrize("ring", RINGS.values(), ids=RINGS.keys())
@pytest.mark.parametrize("begin", range(3))
@pytest.mark.parametrize("way", [1, -1])
def test_a_polygon_keeps_its_area(ring, begin, way):
    ring = np.roll(ring, begin, axis=0)[::way]
    each, notices = areas(ring)
    assert not notices
    assert each.sum() == pytest.approx(area_of(ring))
    assert (np.sign(each) * way > -0.5).all()


@settings(max_examples=60)
@given(st.lists(st.floats(1, 30), min_size=4, max_size=40))
def test_a_star_of_any_radii_keeps_its_area(radii):
    turn = np.arange(len(radii)) * 2 * np.pi / len(radii)
    ring = np.asarray(radii)[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    each, _ = areas(ring)
    assert np.abs(each).sum() == pytest.approx(area_of(ring), rel=1e-6)


def test_a_polygon_that_crosses_itself_is_named():
    _, (notice,) = areas([(0, 0), (6, 5), (6, 0), (0, 4), (-3, 2)])
    assert notice.code == "polygons-crossed"


def test_time_is_limited(monkeypatch):
    monkeypatch.setattr(polygons, "_MOST_STEPS", 10)
    with pytest.raises(UnreadableError, match="8 corners, which are too many"):
        areas(RINGS["U"])
