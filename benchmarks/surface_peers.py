"""Surface from normals: closed forms, and discrete geometry processing on the same maps.

The first table has the mean error of closed forms in percent of their range of heights, on whole
rectangles and on ragged masks, orthographic and perspective. "Xie" is the method of Xie et al.
(CVPR 2014): its facets are moved along the line of sight, or to the nearest point of their planes
in many rounds. With ``--data``, the folder of DiLiGenT's objects (see ``discontinuity.py``), the
second table has the mean absolute error of depth in mm; "jumps" is ours with discontinuity=True.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from discontinuity import error_mm, object_of
from discrete_geometry import heights
from harness import command_line

import acquisition
import processing
from rig.arrays import Bool, Float64

# Height z and slopes dz/dx, dz/dy over -1..1.
Form = Callable[[Float64, Float64], tuple[Float64, Float64, Float64]]


def sphere(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the part of a sphere that is seen up to 70 degrees in the corners."""
    radius = 2**0.5 / np.sin(np.radians(70))
    z = np.sqrt(np.maximum(radius**2 - x**2 - y**2, 1e-6))
    return z, -x / z, -y / z


def peaks(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the sum of three bells that MATLAB calls peaks, up to 60 degrees steep."""
    u, v, scale = 3 * x, 3 * y, 0.045
    a = 3 * np.exp(-(u**2) - (v + 1) ** 2)
    b = -10 * np.exp(-(u**2) - v**2)
    c = -np.exp(-((u + 1) ** 2) - v**2) / 3
    q = u / 5 - u**3 - v**5
    z = a * (1 - u) ** 2 + b * q + c
    zu = a * (-2 * (1 - u) - 2 * u * (1 - u) ** 2) + b * (0.2 - 3 * u**2 - 2 * u * q)
    zv = -2 * (v + 1) * a * (1 - u) ** 2 + b * (-5 * v**4 - 2 * v * q) - 2 * v * c
    return scale * z, 3 * scale * (zu - 2 * (u + 1) * c), 3 * scale * zv


def plane(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    return 0.7 * x - 0.4 * y, np.full_like(x, 0.7), np.full_like(y, -0.4)


def saddle(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    return 0.6 * (x**2 - y**2), 1.2 * x, -1.2 * y


FORMS: dict[str, Form] = {"sphere cap": sphere, "peaks": peaks, "plane": plane, "saddle": saddle}


def ragged(size: int) -> Bool:
    """Return a mask with a rough rim, holes and islands."""
    noise = np.random.default_rng(3).normal(size=(size, size))
    rough = cv2.GaussianBlur(noise, (0, 0), size / 50)
    y, x = np.mgrid[-1 : 1 : size * 1j, -1 : 1 : size * 1j]
    inside = (x**2 + y**2 < 0.85 + 0.1 * rough / rough.std()) & (noise > -2.2)
    _, labels = cv2.connectedComponents(inside.astype(np.uint8), connectivity=4)
    largest: Bool = labels == np.argmax(np.bincount(labels[inside]))
    return largest


def view(form: Form, size: int, *, perspective: bool) -> tuple[Float64, Float64, Float64]:
    """Return normals, heights or depths, and cosines to the line of sight; one unit is 1 px."""
    half = size / 2
    x, y = np.meshgrid(np.arange(size) - half + 0.5, half - 0.5 - np.arange(size))
    facing: Float64
    if not perspective:
        z, zx, zy = form(x / half, y / half)
        normals = np.dstack([-zx, -zy, np.ones_like(z)])
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        return normals, half * z, normals[..., 2]
    focal = camera(size).focal_px
    rays = camera(size).rays(np.dstack(np.meshgrid(np.arange(size), np.arange(size))))
    depth = np.full(x.shape, focal)
    for _ in range(30):
        z, zx, zy = form(rays[..., 0] * depth / half, rays[..., 1] * depth / half)
        off = focal - depth - half * z
        depth += off / (1 + zx * rays[..., 0] + zy * rays[..., 1])
    normals = np.dstack([-zx, -zy, np.ones_like(z)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    facing = -np.einsum("rck,rck->rc", normals, rays)
    return normals, depth, facing


def camera(size: int) -> acquisition.CameraModel:
    """Return a camera with a field of 22 degrees, narrow enough to see all of each form."""
    focal, middle = 2.5 * size, (size - 1) / 2
    K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    return acquisition.CameraModel(K, size, size)


def percent(estimate: Float64, truth: Float64, mask: Bool, *, perspective: bool) -> float:
    """Return the mean error in percent of the range; offset or scale are free."""
    if perspective:
        estimate = estimate * np.median(truth[mask] / estimate[mask])
    else:
        estimate = estimate + np.median((truth - estimate)[mask])
    return float(100 * np.abs(estimate - truth)[mask].mean() / np.ptp(truth[mask]))


def closed_form(name: str, size: int, mask: Bool, *, perspective: bool) -> list[float]:
    """Return the errors of our surface and of the two of Xie et al., in percent of the range."""
    normals, truth, facing = view(FORMS[name], size, perspective=perspective)
    given = processing.NormalMap.from_vectors(normals, mask & (facing > 0.05))
    inside = given.mask
    ours = processing.integrate(given, camera=camera(size) if perspective else None)
    estimates = [np.asarray(ours.depth if perspective else ours.height, np.float64)]
    flat = np.dstack([normals[..., :2], facing])
    for shaping in ("sight", "nearest"):
        z = heights(flat, inside, shaping)
        estimates.append(np.exp(-z / camera(size).focal_px) if perspective else z)
    return [percent(each, truth, inside, perspective=perspective) for each in estimates]


def captured(folder: Path) -> list[float]:
    """Return errors in mm: plain, with jumps, and the two of Xie et al."""
    normals, model, depth = object_of(folder)
    errors = [
        error_mm(
            processing.integrate(normals, camera=model, discontinuity=jumps), depth, normals.mask
        )
        for jumps in (False, True)
    ]
    rays = model.rays(np.dstack(np.meshgrid(*map(np.arange, normals.size[::-1]))))
    facing = -np.einsum("rck,rck->rc", normals.normals, rays)
    inside = normals.mask & (facing > 0.01)
    flat = np.dstack([normals.normals[..., :2], facing])
    for shaping in ("sight", "nearest"):
        z = heights(flat, inside, shaping)
        estimate = np.exp(-z / model.focal_px)
        estimate *= np.median(depth[inside] / estimate[inside])
        errors.append(float(np.abs(estimate - depth)[inside].mean()))
    return errors


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--size", type=int, default=200, help="side of the closed forms, pixels")
    parser.add_argument("--data", type=Path, help="folder of the objects")
    options = parser.parse_args()
    print(f"{'form':10} {'mask':9} {'view':12} {'ours, %':>8} {'Xie, sight':>10} {'nearest':>8}")
    for name in FORMS:
        for shape, mask in (
            ("rectangle", np.ones((options.size, options.size), bool)),
            ("ragged", ragged(options.size)),
        ):
            for perspective in (False, True):
                ours, sight, nearest = closed_form(
                    name, options.size, mask, perspective=perspective
                )
                seen = "perspective" if perspective else "orthographic"
                print(
                    f"{name:10} {shape:9} {seen:12} {ours:8.4f} {sight:10.4f} {nearest:8.4f}",
                    flush=True,
                )
    if options.data is None:
        return
    print(f"\n{'object, mm':10} {'plain':>7} {'jumps':>7} {'Xie, sight':>10} {'nearest':>8}")
    table = []
    for folder in sorted(path for path in options.data.iterdir() if (path / "K.txt").exists()):
        table.append((folder.name, captured(folder)))
        name, errors = table[-1]
        print(f"{name:10} " + " ".join(f"{error:8.3f}" for error in errors), flush=True)


if __name__ == "__main__":
    main()
