"""A small result folder for tests of the report, and the shading of its page in numpy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from acquisition import write_exr, write_mask, write_png
from processing import NormalMap, ShapeFilter, separate, write_normals
from sgp.report import Plane, vectors_plane
from sgp.results import Result, write_record
from tests.sgp.test_report_planes import vectors_of

SIZE = (90, 110)
PIXEL_MM = 0.2


def write_recording(path: Path, count: int = 8) -> Path:
    """Write frames under lights in a ring; frame i has the grey level of `frame_level`."""
    path.mkdir(parents=True)
    lines = [str(count)]
    for number in range(count):
        write_png(path / f"L{number}.png", np.full(SIZE, frame_level(number), np.uint16))
        x, y, z = light_vector(360 * number / count, 45)
        lines.append(f"L{number}.png {x:.6f} {y:.6f} {z:.6f}")
    (path / "lights.lp").write_text("\n".join(lines), encoding="ascii")
    return path


def frame_level(number: int) -> int:
    return 8000 * (number + 1) - 1000


def write_folder(
    path: Path,
    *,
    command: str = "sgp surface",
    inputs: Sequence[Path] = (),
    invented: bool = False,
    **parameters: Any,
) -> Path:
    """Write the maps and the record of a dented ball into a folder."""
    path.mkdir(parents=True)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    x, y = (columns - 54.5) / 50, -(rows - 44.5) / 50
    mask = x**2 + y**2 < 0.7
    relief = 0.12 * np.stack([np.sin(23 * x), np.cos(19 * y)], -1)
    vectors = np.dstack([np.stack([x, y], -1) * 0.8 + relief, np.full(SIZE, 0.7)])
    vectors /= np.linalg.norm(vectors, axis=2, keepdims=True)
    normals = NormalMap(np.where(mask[..., None], vectors, 0).astype(np.float32), mask)
    parts = separate(normals, shape_filter=ShapeFilter(w=2))
    result = Result(inputs=list(inputs))
    result.outputs |= write_normals(path, normals)
    result.outputs |= write_normals(path, parts.shape, "shape")
    colours = np.stack([60 + columns, 220 - rows, 90 + (rows + columns) % 40], -1)
    maps = {
        "height": np.where(mask, np.sqrt(np.maximum(1 - x**2 - y**2, 0)) * 10, np.nan),
        "height_sigma": np.where(mask, 0.01 + 0.02 * np.hypot(x, y), np.nan),
        "normal_sigma_deg": np.where(mask, 0.3 + np.abs(x), np.nan),
    }
    for name, values in maps.items():
        result.outputs[name] = path / f"{name}.exr"
        write_exr(result.outputs[name], values.astype(np.float32))
    result.outputs["albedo_png"] = path / "albedo.png"
    write_png(path / "albedo.png", np.where(mask[..., None], colours, 0).astype(np.uint8))
    if invented:
        result.outputs["invented"] = path / "invented.png"
        write_mask(path / "invented.png", np.abs(x) + np.abs(y) < 0.2)
        angles = ("detail_angle", "surroundings_angle", "seam_step", "interior_step")
        result.metrics = {f"{name}_deg": 1.0 for name in angles} | {"seam_ratio": 1.0}
        result.metrics |= {"pixels": int(mask.sum()), "filled_pixels": 200}
    result.metrics |= {
        "unit": "mm",
        "pixel_size": PIXEL_MM,
        "height_range": 4.5,
        "vertices": int(mask.sum()),
        "parts": 1,
        "iterations": 5,
        "image_residuals": [0.01 * number for number in range(8)],
    }
    write_record(path / "surface.json", command, parameters, result)
    return path


def _linear(samples: np.ndarray) -> np.ndarray:
    c = samples / 255
    return np.where(c > 0.04045, ((c + 0.055) / 1.055) ** 2.4, c / 12.92)


def _srgb(light: np.ndarray) -> np.ndarray:
    c = np.clip(light, 0, 1)
    return 255 * np.where(c > 0.0031308, 1.055 * c ** (1 / 2.4) - 0.055, 12.92 * c)


def _turn(vectors: np.ndarray, poles: np.ndarray, sign: int) -> np.ndarray:
    """Rodrigues' formula for the shortest rotation that takes each pole to z; sign -1 inverts."""
    axis = sign * np.cross(poles, [0, 0, 1])
    c = poles[..., 2:]
    along = (axis * vectors).sum(-1, keepdims=True)
    return c * vectors + np.cross(axis, vectors) + axis * along / (1 + c)


def light_vector(azimuth: float, elevation: float) -> np.ndarray:
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _smoothed(vectors: np.ndarray, sigma: float) -> np.ndarray:
    """Three box filters of about a standard deviation, and the steps of a plane of directions."""
    radius = max(1, round((sigma**2 + 0.25) ** 0.5 - 0.5))
    kernel = np.ones(2 * radius + 1) / (2 * radius + 1)
    found = vectors
    for axis in (0, 1) * 3:
        found = np.apply_along_axis(np.convolve, axis, found, kernel, "same")
    found = np.where(vectors.any(axis=2, keepdims=True), found, 0)
    found /= np.maximum(np.linalg.norm(found, axis=2, keepdims=True), 1e-12)
    return vectors_of(vectors_plane("any", found.astype(np.float32), "").samples)


def _near(planes: dict[str, Plane], direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return directions and strengths of a light one diagonal away from the middle of the map."""
    plane = planes["height"]
    rows, columns = plane.samples.shape[:2]
    y, x = np.mgrid[:rows, :columns] + 0.5
    height = plane.low + plane.step * (plane.samples[..., 0].astype(float) - 1)
    z = (height - sum(plane.shown) / 2) / PIXEL_MM
    distance = np.hypot(rows, columns)
    way = distance * direction - np.dstack([x - columns / 2, rows / 2 - y, z])
    far = np.linalg.norm(way, axis=2, keepdims=True)
    return way / far, (distance / far) ** 2


def shaded(
    planes: dict[str, Plane],
    mode: str,
    light: tuple[float, float],
    *,
    exaggeration: float = 1.0,
    smoothing: float = 0.0,
    near: bool = False,
) -> np.ndarray:
    """Return ``(H, W, 3)`` samples 0..255 of a page at 1:1, as its shader computes them."""
    n = vectors_of(planes["normals"].samples)
    mask = n.any(axis=2)
    flat = np.full_like(n, [0, 0, 1])
    shape = vectors_of(planes["shape"].samples) if "shape" in planes else flat
    if smoothing:
        n, shape = _smoothed(n, smoothing), _smoothed(shape, smoothing)
    detail = _turn(n, shape, 1) * [exaggeration, exaggeration, 1]
    detail /= np.maximum(np.linalg.norm(detail, axis=2, keepdims=True), 1e-9)
    n = {"shape": shape, "detail": detail}.get(mode, _turn(detail, shape, -1))
    direction = light_vector(*light)
    ways, strength = _near(planes, direction) if near else (direction, 1.0)
    lit = strength * np.maximum((n * ways).sum(-1, keepdims=True), 0)
    albedo = _linear(planes["albedo"].samples.astype(float)) if "albedo" in planes else 1.0
    if mode == "shaded":
        found = _srgb(lit * albedo)
    elif mode == "specular":
        half = ways + np.array([0, 0, 1])
        half /= np.linalg.norm(half, axis=-1, keepdims=True)
        facing = np.maximum((n * half).sum(-1, keepdims=True), 0)
        glint = strength * np.where(lit > 0, facing**30, 0)
        found = _srgb(0.5 * lit * albedo + 0.5 * glint)
    elif mode == "albedo":
        found = _srgb(albedo)
    elif mode == "normals":
        found = 255 * (0.5 + 0.5 * n)
    else:
        found = _srgb(np.repeat(lit, 3, axis=2))
    return np.where(mask[..., None], found, 0)
