"""Light that an object reflects onto itself, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquisition import CameraModel, Lights, angle_deg, read_source, write_png
from processing import Reconstruction, reconstruct
from processing.images.coarse_images import coarse_images
from processing.images.viewing_rays import Parallel, Perspective, View
from processing.series.interreflection import _form_factors
from rig.arrays import Bool, Float64
from tests.processing.scenes import dome, half_ball

SHAPE = (112, 28)
CAMERA = CameraModel(
    np.array([[63.0, 0, 13.5], [0, 63, 55.5], [0, 0, 1]]), 28, 112, working_distance_mm=300
)


@pytest.mark.parametrize(
    "view", [Parallel(0.7, SHAPE, (13.5, 55.5)), Perspective(CAMERA)], ids=["parallel", "camera"]
)
def test_a_groove_of_90_degrees(view: View) -> None:
    """At the distance x from its edge, a wall receives (1 - x / sqrt(x^2 + w^2)) / 2.

    The other wall is w wide, and so long that its ends do not matter.
    """
    everywhere = np.ones(SHAPE, bool)
    coarse = coarse_images(np.zeros((1, *SHAPE), np.float32), everywhere, view, 10**9)
    plane = coarse.points(np.full(SHAPE, view.distance_mm))[..., 0]
    depth = view.distance_mm - np.abs(plane)
    if isinstance(view, Perspective):
        depth = view.distance_mm / (1 + np.abs(plane) / view.distance_mm)
    x = coarse.points(depth)[..., 0]
    normals = np.dstack([-np.sign(x), 0 * x, 1 + 0 * x]).reshape(-1, 3) / np.sqrt(2)
    factors = _form_factors(coarse, depth.ravel(), everywhere, normals)
    received = factors.sum(axis=1, dtype=np.float64).reshape(SHAPE)[SHAPE[0] // 2]
    x = np.abs(x[SHAPE[0] // 2])
    width = x[0] + (x[0] - x[1]) / 2
    away = x > 0.2 * width  # nearer, squares are large
    exact = (1 - x / np.hypot(x, width)) / 2
    np.testing.assert_allclose(received[away], exact[away], rtol=0.06)
    left = (coarse.points(depth)[..., 0] < 0).ravel()
    assert not factors[np.ix_(left, left)].any()


def bowl(lights: Float64, albedo: float) -> tuple[Float64, Float64, Bool]:
    """Return images and normals of a part of a hollow sphere, up to 65 degrees from its bottom.

    All points of a sphere receive the same light from any other: its share of the surface.
    """
    y, x = np.mgrid[1:-1:64j, -1:1:64j]
    rim = np.radians(65)
    depth = np.sqrt(np.clip(1 - x**2 - y**2, 0, None))
    mask = np.hypot(x, y) < np.sin(rim)
    normals = np.dstack([-x, -y, depth])
    cosine = np.maximum(np.einsum("nc,hwc->nhw", lights, normals), 0)
    # A ray leaves the sphere, through the opening if it is not in shadow.
    direct = np.where(2 * cosine * lights[:, 2, None, None] - depth > -np.cos(rim), cosine, 0)
    area = np.where(mask, 1 / np.maximum(depth, 0.1), 0)
    mean = (direct * area).sum(axis=(1, 2)) / area.sum()
    share = (1 - np.cos(rim)) / 2
    reflected = share * albedo * mean / (1 - share * albedo)
    return albedo * (direct + reflected[:, None, None]), normals, mask


def errors(
    folder: Path, images: Float64, lights: Lights, normals: Float64, mask: Bool, **options: float
) -> tuple[float, float, Reconstruction]:
    """Return the mean errors in degrees without and with the option, and the second result."""
    for k, image in enumerate(images):
        values = np.where(mask, image, 0)
        write_png(folder / f"o.{k:02d}.png", (60_000 * values).round().astype(np.uint16))
    source = read_source(folder, lights=lights)
    made = [
        reconstruct(source, surface=False, interreflection=on, **options) for on in (False, True)
    ]
    off = [
        float(angle_deg(each.normals.normals, normals)[mask & each.valid].mean()) for each in made
    ]
    return off[0], off[1], made[1]


@pytest.mark.slow
@pytest.mark.parametrize("near", [False, True])
def test_a_bowl(tmp_path: Path, near: bool) -> None:
    directions = dome(24)
    images, normals, mask = bowl(directions, 0.7)
    lights, options = Lights(directions), {}
    if near:
        lights = Lights(positions_mm=1e5 * directions, mu=np.zeros(24))
        options = {"pixel_mm": 1.0, "height_mm": 0.0}
    before, after, made = errors(tmp_path, images, lights, normals, mask, **options)
    assert before > 2
    assert after < 0.3 * before
    assert "light-reflected" in {notice.code for notice in made.warnings}


def test_a_ball_reflects_nothing_onto_itself(tmp_path: Path) -> None:
    normals, mask = half_ball(60)
    directions = dome(24)
    images = 0.7 * np.maximum(np.einsum("nc,hwc->nhw", directions, normals), 0)
    images += np.random.default_rng(941).normal(0, 2e-3, images.shape)
    images = np.clip(images, 0, 1)
    before, after, made = errors(tmp_path, images, Lights(directions), normals, mask)
    assert after == before
    notice = next(each for each in made.warnings if each.code == "light-reflected")
    assert notice.text.startswith("no light")
