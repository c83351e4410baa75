from __future__ import annotations

import cv2
import numpy as np
import pytest

from acquisition import angle_deg
from processing import NormalMap, ShapeFilter, read_normals, separate
from processing.detail import FilterKind
from rig.arrays import Bool, Float64
from tests.real_data import DATA, needs_data

PAPER = ShapeFilter("gaussian", 1, 5)
UP = (0.0, 0.0, 1.0)


def caps(seed: int, size: int = 320) -> tuple[NormalMap, Float64]:
    """Return a map with many occlusions, balls with relief in front of a relief, and its depth.

    The parameters of the filters were chosen on scenes of this kind with other seeds, so these
    scenes and real maps are an independent test.
    """
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:size, :size].astype(float)

    def relief() -> tuple[Float64, Float64]:
        steepness, wavelength = rng.uniform(0.1, 0.35), rng.uniform(1.2, 3)
        dy, dx = np.gradient(cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), wavelength))
        gain = steepness / np.hypot(dx, dy).std()
        return gain * dx, gain * dy

    height = 0.15 * x + 0.1 * y
    dx, dy = relief()
    dx, dy = dx + 0.15, dy + 0.1
    for _ in range(9):
        cx, cy = rng.uniform(20, size - 20, 2)
        radius, lift = rng.uniform(30, 70), rng.uniform(15, 60)
        distance2 = (x - cx) ** 2 + (y - cy) ** 2
        rise = np.sqrt(np.maximum(radius**2 - distance2, 1))
        front = (distance2 < (0.97 * radius) ** 2) & (lift + rise > height)
        relief_x, relief_y = relief()
        dx = np.where(front, relief_x - (x - cx) / rise, dx)
        dy = np.where(front, relief_y - (y - cy) / rise, dy)
        height = np.where(front, lift + rise, height)
    return NormalMap.from_vectors(np.stack([-dx, dy, np.ones_like(dx)], axis=2)), height


def occlusion_band(depth: Float64, mask: Bool, jump: float = 5.0, reach_px: float = 5.0) -> Bool:
    """Return the pixels of a mask near a depth jump between neighbours."""
    inside = mask & np.isfinite(depth)
    depth = np.where(inside, depth, 0)
    jumps = np.zeros(mask.shape, bool)
    across = inside[:, 1:] & inside[:, :-1] & (np.abs(np.diff(depth, axis=1)) > jump)
    down = inside[1:] & inside[:-1] & (np.abs(np.diff(depth, axis=0)) > jump)
    jumps[:, 1:] |= across
    jumps[:, :-1] |= across
    jumps[1:] |= down
    jumps[:-1] |= down
    far = cv2.distanceTransform((~jumps).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return mask & (np.asarray(far) <= reach_px)


def figures(normal_map: NormalMap, band: Bool, by: ShapeFilter) -> tuple[float, float, float]:
    """Return mean residual angles in the band, by both filters, and the detail angle elsewhere."""
    parts = separate(normal_map, shape_filter=by)
    own = parts.separability_map_deg[band].mean()
    paper = angle_deg(PAPER.shape(parts.detail).normals[band], UP).mean()
    away = angle_deg(parts.detail.normals[normal_map.mask & ~band], UP).mean()
    return float(own), float(paper), float(away)


def mean_figures(maps: list[tuple[NormalMap, Bool]], by: ShapeFilter) -> Float64:
    return np.asarray([figures(*case, by) for case in maps]).mean(axis=0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["guided", "bilateral"])
def test_the_residue_at_occlusions_is_smaller_and_relief_remains(kind: FilterKind) -> None:
    maps = [
        (normal_map, occlusion_band(depth, normal_map.mask))
        for normal_map, depth in map(caps, (0, 1))
    ]
    own, leak, kept = mean_figures(maps, ShapeFilter(kind)) / mean_figures(maps, PAPER)
    assert own <= 0.3
    assert leak <= 0.5
    assert kept >= 0.75


@needs_data
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["guided", "bilateral"])
def test_occlusions_of_real_objects(kind: FilterKind) -> None:
    root = DATA / "normals" / "diligent"
    maps = []
    for name in ("bear", "buddha", "cat", "cow", "goblet"):
        normal_map = read_normals(root / name).normal_map
        with np.load(root / name / "depth_gt.npz") as file:
            depth = file[file.files[0]].astype(np.float64)
        maps.append((normal_map, occlusion_band(depth, normal_map.mask)))
    own_deg, leak_deg, kept_deg = mean_figures(maps, ShapeFilter(kind))
    _, paper_leak_deg, paper_kept_deg = mean_figures(maps, PAPER)
    _, default_leak_deg, _ = mean_figures(maps, ShapeFilter())
    assert own_deg <= 1.2
    assert leak_deg <= 0.5 * min(paper_leak_deg, default_leak_deg)
    assert kept_deg >= 0.75 * paper_kept_deg


@pytest.mark.parametrize("kind", ["guided", "bilateral"])
def test_there_is_no_seam_between_two_slopes(kind: FilterKind) -> None:
    vectors = np.zeros((40, 60, 3))
    vectors[:, :30], vectors[:, 30:] = (0.6, 0, 0.8), (-0.6, 0, 0.8)
    roof = NormalMap.from_vectors(vectors)
    seam = separate(roof, shape_filter=ShapeFilter(kind=kind)).detail.normals[:, 28:32]
    gauss = separate(roof, shape_filter=ShapeFilter(order=1)).detail.normals[:, 28:32]
    assert angle_deg(seam, UP).mean() < 0.4 * angle_deg(gauss, UP).mean()


@pytest.mark.parametrize("kind", ["guided", "bilateral"])
def test_the_background_does_not_affect_the_rim(kind: FilterKind) -> None:
    mask = np.hypot(*np.mgrid[-20:21, -20:21]) < 15
    plane = NormalMap.from_vectors(np.broadcast_to((0.48, -0.6, 0.64), (41, 41, 3)), mask)
    parts = separate(plane, shape_filter=ShapeFilter(kind=kind))
    assert angle_deg(parts.shape.normals, plane.normals)[mask].max() < 1e-3
    assert not parts.shape.normals[~mask].any()
    assert not parts.detail.normals[~mask].any()
