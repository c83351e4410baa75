"""Lights, balls and reliefs that several tests of normals use."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numba
import numpy as np
import pytest
import trimesh

from processing import Geometry, NormalMap, read_geometry
from rig.arrays import Bool, Float64
from tests.real_data import DATA


def dome(count: int, highest: float = 0.98, lowest: float = 0.35) -> Float64:
    """Return directions ``(N, 3)`` spread over a dome by the golden angle."""
    z = np.linspace(highest, lowest, count)
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def sunflower(count: int, height: float) -> Float64:
    """Return vectors to lights that are spread evenly over a disc above the object."""
    around = np.arange(count) * 2.4
    out = np.sqrt((np.arange(count) + 0.5) / count)
    return np.stack([out * np.cos(around), out * np.sin(around), height + 0 * out], 1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Let kernels use a single thread."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        yield
    finally:
        numba.set_num_threads(before)


def half_ball(size: int, rim: float = 0.95) -> tuple[Float64, Bool]:
    """Return normals of a ball that fills the frame, with y down, and a mask within its rim."""
    y, x = np.mgrid[1 : -1 : size * 1j, -1 : 1 : size * 1j]
    z = np.sqrt(np.clip(1 - x * x - y * y, 0, None))
    return np.dstack([x, y, z]), np.hypot(x, y) < rim


def bumpy_dome(waves: Float64, amount: float, steepness: float = 1.0) -> tuple[Float64, Bool]:
    """Return normals of a dome with waves of a square frame on it, and its mask."""
    size = len(waves)
    rows, columns = np.indices(waves.shape)
    middle, radius = (size - 1) / 2, size / 2 - 4
    x, y = (columns - middle) / radius, (middle - rows) / radius
    height = 0.4 * np.sqrt(np.clip(1.2 - x**2 - y**2, 0, 1)) + amount * waves / waves.std()
    down, right = np.gradient(steepness * height, 1 / radius)
    normals = np.dstack([-right, down, np.ones_like(height)])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True), x**2 + y**2 < 1


def ball(rows: int = 120, columns: int | None = None, rim: float = 0.8) -> NormalMap:
    """Return a ball, of which the middle is in the mask."""
    y, x = np.mgrid[1 : -1 : rows * 1j, -1 : 1 : (columns or rows) * 1j]
    z = np.sqrt(np.maximum(1.6 - x**2 - y**2, 0))
    return NormalMap.from_vectors(np.dstack([x, y, z]), x**2 + y**2 < rim)


def relief(seed: int, size: tuple[int, int], slope: float = 3.0, blur_px: float = 1.2) -> NormalMap:
    """Return a rough map over the complete frame: a weak relief on a flat shape."""
    height = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=size), (0, 0), blur_px)
    dy, dx = np.gradient(height)
    return NormalMap.from_vectors(np.dstack([-slope * dx, slope * dy, np.ones(size)]))


def waves(
    size: tuple[int, int],
    seed: int,
    slopes: tuple[float, float],
    lengths_px: tuple[float, float],
    error: float = 0.1,
    mask: Bool | None = None,
) -> NormalMap:
    """Return waves to the right and downwards, with noise."""
    y, x = np.mgrid[: size[0], : size[1]]
    rough = np.random.default_rng(seed).normal(0, error, (2, *size))
    right = slopes[0] * np.sin(x / lengths_px[0]) + rough[0]
    down = slopes[1] * np.cos(y / lengths_px[1]) + rough[1]
    return NormalMap.from_vectors(np.dstack([right, down, np.ones(size)]), mask)


def folds(size: tuple[int, int], length_px: float, hole: tuple[slice, ...]) -> NormalMap:
    """Return bent waves with a hole."""
    y, x = np.mgrid[: size[0], : size[1]]
    slopes = 0.3 * np.sin(x / length_px + np.sin(y / 4)), 0.3 * np.cos(y / 3)
    mask = np.ones(size, np.bool_)
    mask[hole] = False
    return NormalMap.from_vectors(np.dstack([*slopes, np.ones(size)]), mask)


def noise(side: int = 64, seed: int = 2) -> NormalMap:
    """Return normals with independent errors."""
    vectors = np.random.default_rng(seed).normal(scale=0.2, size=(side, side, 3))
    return NormalMap.from_vectors(vectors + np.array([0, 0, 1]))


def mesh_named(name: str, sections: int = 64) -> Geometry:
    """Return a torus, or a mesh of the real data, without which the test is skipped."""
    if name == "torus":
        ring = trimesh.creation.torus(20.0, 8.0, sections, sections // 2)
        return Geometry(ring.vertices, ring.faces)
    path = DATA / "meshes" / f"{name}.obj"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return read_geometry(path)


def real_map(folder: str) -> NormalMap:
    """Return a normal map of the paper."""
    path = DATA / "normals" / folder
    image = np.asarray(cv2.imread(str(path / "normal_map.png"), cv2.IMREAD_UNCHANGED))
    mask = np.asarray(cv2.imread(str(path / "mask.png"), cv2.IMREAD_GRAYSCALE)) > 127
    full = np.iinfo(image.dtype).max
    return NormalMap.from_vectors(image[..., 2::-1].astype(np.float64) / full * 2 - 1, mask)
