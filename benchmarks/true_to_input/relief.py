"""A relief with known normals under distant lights; the error of `sgp normals` on its images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from true_to_input.case import Answer, sgp

from rig.arrays import Floating

H, W = 96, 120
_Y, _X = np.mgrid[:H, :W]
INSIDE = ((_X - W / 2) / 50) ** 2 + ((_Y - H / 2) / 40) ** 2 < 1
MASK = INSIDE.astype(np.uint8) * 255


def surface() -> tuple[Floating, Floating]:
    """Return normals ``(H, W, 3)`` (right, up, toward the viewer) and albedo."""
    u, v = (_X - W / 2) / 40, -(_Y - H / 2) / 40
    bump = 0.5 * np.exp(-((u - 0.2) ** 2 + (v + 0.1) ** 2) / 0.5)
    z = bump + 0.12 * np.sin(3 * u + 0.4) * np.cos(4 * v) + 0.1 * u * v
    down, right = np.gradient(z, 1 / 40)
    normals = np.stack([-right, down, np.ones_like(z)], -1)
    albedo = (0.5 + 0.2 * np.sin(5 * u) * np.sin(3 * v + 1)) * INSIDE
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True), albedo


def directions(count: int = 12) -> Floating:
    """Return unit directions ``(count, 3)`` that spread over the hemisphere."""
    k = np.arange(count)
    around, up = k * 2.399963, np.deg2rad(35 + 35 * ((k * 0.37) % 1))
    return np.stack([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)], -1)


def images(
    lights: Floating, *, noise: float = 0.001, scale: float = 0.9, seed: int = 0
) -> Floating:
    """Return linear images ``(count, H, W)`` from 0 to 1."""
    normals, albedo = surface()
    clean = np.clip(np.einsum("hwc,nc->nhw", normals, lights), 0, None) * albedo * scale
    return np.clip(clean + np.random.default_rng(seed).normal(0, noise, clean.shape), 0, 1)


def write_lp(path: Path, names: Sequence[str], lights: Floating) -> None:
    rows = [
        f"{name} {x:.6f} {y:.6f} {z:.6f}" for name, (x, y, z) in zip(names, lights, strict=True)
    ]
    path.write_text("\n".join([str(len(rows)), *rows]) + "\n", encoding="utf-8")


def error_of(
    folder: Path, *options: object, mask: Path | None = None
) -> tuple[Answer, float | None]:
    """Run `sgp normals` on a folder; return its answer and the mean angle to the truth, degrees.

    The angle is 180 if the result has another size or covers less than half of the relief, and None
    if the command was refused.
    """
    out = folder.with_name(f"{folder.name}.out")
    words = ["--mask", mask] if mask else []
    answer = sgp("normals", folder, *options, *words, "--out", out, "--force")
    if answer.code:
        return answer, None
    found = cv2.imread(str(out / "normals.png"), cv2.IMREAD_UNCHANGED)
    if found.shape[:2] != (H, W):
        return answer, 180.0
    vectors = found[..., 2::-1] / 65535.0 * 2 - 1
    seen = INSIDE & (found[..., 3] > 0)
    if seen.sum() < INSIDE.sum() / 2:
        return answer, 180.0
    vectors, truth = vectors[seen], surface()[0][seen]
    crossed, along = np.linalg.norm(np.cross(vectors, truth), axis=-1), (vectors * truth).sum(-1)
    return answer, float(np.rad2deg(np.arctan2(crossed, along)).mean())
