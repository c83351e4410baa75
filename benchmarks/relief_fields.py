"""A large painted relief with known heights, and fields of view that are cut out of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import map_coordinates

from acquisition import write_exr
from processing import NormalMap, write_normals
from processing.registration import Field
from rig.arrays import Float32, Float64
from sgp.results import Result, write_record

# Widths of the structure of a relief in pixels, and its slopes at each.
_STRUCTURE = ((1.5, 0.05), (4.0, 0.08), (12.0, 0.08), (40.0, 0.06), (150.0, 0.05))


@dataclass(frozen=True, eq=False)
class Relief:
    """A relief.

    Parameters
    ----------
    height
        ``(H, W)`` in pixels, upward.
    albedo
        ``(H, W)``.
    """

    height: Float32
    albedo: Float32


def relief(size: tuple[int, int], seed: int) -> Relief:
    """Return a relief with structure of all widths, and paint."""
    rng = np.random.default_rng(seed)
    height = np.zeros(size, np.float32)
    for width, slope in _STRUCTURE:
        if width > min(size) / 4:
            continue
        made = _smooth_noise(size, width, rng)
        made *= slope / np.sqrt(np.mean(np.diff(made, axis=0) ** 2))
        height += made
    paint = _smooth_noise(size, 3.0, rng) + 2 * _smooth_noise(size, 25.0, rng)
    return Relief(height, np.asarray(0.4 * np.exp(0.15 * paint), np.float32))


def _smooth_noise(size: tuple[int, int], width: float, rng: np.random.Generator) -> Float32:
    """Return noise of a width with the standard deviation 1; a wide one from fewer pixels."""
    step = max(1, int(width / 3))
    coarse = rng.standard_normal([length // step + 8 for length in size]).astype(np.float32)
    coarse = cv2.GaussianBlur(coarse, (0, 0), width / step)
    made = cv2.resize(coarse, None, fx=step, fy=step, interpolation=cv2.INTER_CUBIC)
    made = made[: size[0], : size[1]]
    return np.asarray(made / made.std(), np.float32)


@dataclass(frozen=True)
class View:
    """Where a field is: its middle (column, row) in the relief, and its turn in radians."""

    column: float
    row: float
    turn: float
    gain: float = 1.0
    sigma_deg: float = 1.0
    tilt: tuple[float, float] = (0.0, 0.0)

    def matrix(self, size: tuple[int, int]) -> Float64:
        """Return the matrix from pixels of the field to those of the relief."""
        cos, sin = math.cos(self.turn), math.sin(self.turn)
        middle = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2])
        turn = np.array([[cos, -sin], [sin, cos]])
        made = np.eye(3)
        made[:2, :2] = turn
        made[:2, 2] = [self.column, self.row] - turn @ middle
        return made


def seen(whole: Relief, view: View, size: tuple[int, int], seed: int) -> tuple[Field, NormalMap]:
    """Return a field with the noise of its normals, and its true normals."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float64)
    x, y, _ = np.tensordot(view.matrix(size), np.stack([columns, rows, np.ones(size)]), 1)
    normals = true_normals(whole, x, y)
    # The object is turned in the image by the opposite angle.
    cos, sin = math.cos(-view.turn), math.sin(-view.turn)
    made = normals.copy()
    made[..., 0] = cos * normals[..., 0] + sin * normals[..., 1]
    made[..., 1] = cos * normals[..., 1] - sin * normals[..., 0]
    truth = NormalMap.from_vectors(made)
    sigma = view.sigma_deg * rng.uniform(0.7, 1.3, size).astype(np.float32)
    noise = rng.standard_normal((*size, 3)) * np.radians(sigma)[..., None] / math.sqrt(2)
    noise[..., :2] += np.radians(view.tilt)
    albedo = view.gain * map_coordinates(*_around(whole.albedo, x, y), order=3)
    albedo *= 1 + 0.02 * rng.standard_normal(size)
    field = Field(
        NormalMap.from_vectors(truth.normals + noise),
        albedo.astype(np.float32),
        sigma,
    )
    return field, truth


def true_normals(whole: Relief, x: Float64, y: Float64) -> Float64:
    """Return the normals of a relief at columns and rows."""
    height, at = _around(whole.height, x, y)
    right, down = (map_coordinates(np.gradient(height, axis=axis), at, order=3) for axis in (1, 0))
    made = np.stack([-right, down, np.ones_like(right)], axis=-1)
    return np.asarray(made / np.linalg.norm(made, axis=-1, keepdims=True))


def _around(image: Float32, x: Float64, y: Float64) -> tuple[Float32, Float64]:
    """Return the part of an image that is needed at columns and rows, and these in the part."""
    left, top = max(0, int(x.min()) - 12), max(0, int(y.min()) - 12)
    part = image[top : int(y.max()) + 13, left : int(x.max()) + 13]
    return part, np.stack([y - top, x - left])


def write_field(folder: Path, field: Field, **parameters: object) -> Path:
    """Write a field as a result of ``sgp normals``."""
    outputs = write_normals(folder, field.normal_map)
    known = {"albedo": field.albedo, "normal_sigma_deg": field.sigma_deg}
    for name, values in known.items():
        if values is not None:
            outputs[name] = folder / f"{name}.exr"
            write_exr(outputs[name], values)
    pixels = int(field.mask.sum())
    metrics = {"images": 12, "lights": "distant", "pixels": pixels, "coverage": 1.0}
    metrics |= {"residual_rms": 0.0, "normal_sigma_common_deg": 0.0}
    if field.sigma_deg is not None:
        metrics["normal_sigma_deg"] = float(np.median(field.sigma_deg[field.mask]))
    result = Result(outputs=outputs, metrics=metrics)
    write_record(folder / "normals.json", "sgp normals", parameters, result)
    return folder
