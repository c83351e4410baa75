"""Surface from normals, with which the paper makes its surfaces: closed forms and captured maps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

import acquisition
import processing
from benchmarks.paper.comparison import Comparison
from benchmarks.paper.peers import ours, xie2014
from benchmarks.paper.peers.protocol import costs
from benchmarks.paper.sources import DILIGENT, Sources
from benchmarks.paper.tables import Number, Table
from rig import Progress
from rig.arrays import Bool, Float64, Floating

# Height z and slopes dz/dx, dz/dy over -1..1.
Form = Callable[[Float64, Float64], tuple[Float64, Float64, Float64]]

_SIDE_PX = 200
_SHAPINGS: tuple[xie2014.Shaping, ...] = ("sight", "nearest")
_LEAST_FACING = 0.05

_PREFACE = (
    "# Surface from normals\n\n"
    "The surface of this program next to discrete geometry processing (Xie et al., CVPR 2014), the "
    "method of the paper, written from its published mathematics: facets are moved along the line "
    "of sight, or to the nearest points of their planes in many rounds."
)


def run_surface(*, quick: bool, advance: Progress) -> Comparison:
    """Compute all tables of surfaces that the available data allow.

    Parameters
    ----------
    quick
        No facets moved to nearest points on captured maps.
    advance
        Called before each step: what it does, and how much of this table is done.
    """
    comparison = Comparison(_PREFACE)
    comparison.tables.append(_closed_forms(advance))
    sources = Sources.found()
    if sources.data is None:
        comparison.without_data("the objects of DiLiGenT are left out")
        return comparison
    folder = sources.data / "normals" / "diligent"
    comparison.tables.append(_captured(folder, quick, advance))
    names = ("normal_map.png", "mask.png", "K.txt", "depth_gt.npz")
    comparison.files = [folder / each / name for each in DILIGENT for name in names]
    return comparison


def _sphere(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the part of a sphere that is seen up to 70 degrees in the corners."""
    radius = 2**0.5 / np.sin(np.radians(70))
    z = np.sqrt(np.maximum(radius**2 - x**2 - y**2, 1e-6))
    return z, -x / z, -y / z


def _peaks(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
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


def _plane(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    return 0.7 * x - 0.4 * y, np.full_like(x, 0.7), np.full_like(y, -0.4)


def _saddle(x: Float64, y: Float64) -> tuple[Float64, Float64, Float64]:
    return 0.6 * (x**2 - y**2), 1.2 * x, -1.2 * y


FORMS: dict[str, Form] = {
    "sphere cap": _sphere,
    "peaks": _peaks,
    "plane": _plane,
    "saddle": _saddle,
}


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
    if not perspective:
        z, zx, zy = form(x / half, y / half)
        normals = np.dstack([-zx, -zy, np.ones_like(z)])
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        return normals, half * z, np.asarray(normals[..., 2])
    focal = camera(size).focal_px
    rays = _rays(camera(size), (size, size))
    depth = np.full(x.shape, focal)
    for _ in range(30):
        z, zx, zy = form(rays[..., 0] * depth / half, rays[..., 1] * depth / half)
        off = focal - depth - half * z
        depth += off / (1 + zx * rays[..., 0] + zy * rays[..., 1])
    normals = np.dstack([-zx, -zy, np.ones_like(z)])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return normals, depth, _facing(normals, rays)


def camera(size: int) -> acquisition.CameraModel:
    """Return a camera with a field of 22 degrees, narrow enough to see all of each form."""
    focal, middle = 2.5 * size, (size - 1) / 2
    K = np.array([[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    return acquisition.CameraModel(K, size, size)


def closed_form(name: str, size: int, mask: Bool, *, perspective: bool) -> list[float]:
    """Return the errors of our surface and of the two of Xie et al., in percent of the range."""
    normals, truth, facing = view(FORMS[name], size, perspective=perspective)
    given = processing.NormalMap.from_vectors(normals, mask & (facing > _LEAST_FACING))
    model = camera(size) if perspective else None
    made = processing.integrate(given, camera=model)
    estimates = [np.asarray(made.depth if perspective else made.height, np.float64)]
    flat = np.dstack([normals[..., :2], facing])
    for shaping in _SHAPINGS:
        z = xie2014.PEER.fit(shaping)((flat, given.mask))
        estimates.append(z if model is None else np.exp(-z / model.focal_px))
    return [_percent(each, truth, given.mask, perspective=perspective) for each in estimates]


def object_of(
    folder: Path,
) -> tuple[processing.NormalMap, acquisition.CameraModel, Float64]:
    """Return normals, camera and true depth in mm of an object of DiLiGenT."""
    read = processing.read_normals(folder / "normal_map.png").normal_map
    mask = acquisition.read_mask(folder / "mask.png", read.size)
    with np.load(folder / "depth_gt.npz") as stored:
        depth = stored[stored.files[0]].astype(np.float64)
    model = acquisition.read_camera(folder / "K.txt", read.size)
    return processing.NormalMap.from_vectors(read.normals, mask), model, depth


def error_mm(surface: processing.HeightMap, depth: Float64, mask: Bool) -> float:
    """Return the mean absolute error; a pixel without a depth has that of the nearest one."""
    return _error_mm(filled(surface, mask), depth, mask)


def filled(surface: processing.HeightMap, mask: Bool) -> Float64:
    """Return the depth, at pixels without one that of the nearest pixel."""
    depth, known = np.asarray(surface.depth), surface.mask
    if not (mask & ~known).any():
        return depth.astype(np.float64)
    _, nearest = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    values = np.zeros(nearest.max() + 1)
    values[nearest[known]] = depth[known]
    return np.asarray(values[nearest])


def for_xie(normals: processing.NormalMap, model: acquisition.CameraModel) -> tuple[Float64, Bool]:
    """Return the vectors and the mask that Xie et al. need for a perspective view."""
    facing = _facing(normals.normals, _rays(model, normals.size))
    inside = normals.mask & (facing > 0.01)
    return np.dstack([normals.normals[..., :2], facing]).astype(np.float64), inside


def _error_mm(estimate: Float64, depth: Float64, mask: Bool) -> float:
    scale = np.median(depth[mask] / estimate[mask])
    return float(np.abs(depth - scale * estimate)[mask].mean())


def _facing(normals: Floating, rays: Float64) -> Float64:
    return np.asarray(-np.einsum("rck,rck->rc", normals, rays))


def _rays(model: acquisition.CameraModel, size: tuple[int, int]) -> Float64:
    return model.rays(np.dstack(np.meshgrid(*map(np.arange, size[::-1]))))


def _percent(estimate: Float64, truth: Float64, mask: Bool, *, perspective: bool) -> float:
    """Return the mean error in percent of the range; offset or scale are free."""
    if perspective:
        estimate = estimate * np.median(truth[mask] / estimate[mask])
    else:
        estimate = estimate + np.median((truth - estimate)[mask])
    return float(100 * np.abs(estimate - truth)[mask].mean() / np.ptp(truth[mask]))


def _closed_forms(advance: Progress) -> Table:
    rows: dict[str, list[Number]] = {}
    masks = {
        "rectangle": np.ones((_SIDE_PX, _SIDE_PX), np.bool_),
        "ragged mask": ragged(_SIDE_PX),
    }
    for done, name in enumerate(FORMS):
        advance(f"surface of {name}", done, len(FORMS))
        for shape, mask in masks.items():
            for perspective in (False, True):
                seen = "perspective" if perspective else "orthographic"
                rows[f"{name}, {shape}, {seen}"] = [
                    1e4 * error
                    for error in closed_form(name, _SIDE_PX, mask, perspective=perspective)
                ]
    return Table(
        "closed_forms",
        "Closed forms: mean error of heights, in millionths of their range",
        ("this program", "Xie, along the line of sight", "Xie, to nearest points"),
        rows,
        f"{_SIDE_PX} x {_SIDE_PX} pixels with exact normals. The paper prints no error of surfaces "
        "from normals.",
    )


def _captured(folder: Path, quick: bool, advance: Progress) -> Table:
    rows: dict[str, list[Number]] = {}
    for done, name in enumerate(DILIGENT):
        advance(f"surface of {name}", done, len(DILIGENT))
        normals, model, depth = object_of(folder / name)
        figures: list[Number] = []
        for jumps in (None, False):
            made = processing.integrate(normals, camera=model, discontinuity=jumps)
            figures.append(error_mm(made, depth, normals.mask))
        given = for_xie(normals, model)
        for shaping in _SHAPINGS[: 1 if quick else 2]:
            z = xie2014.PEER.fit(shaping)(given)
            figures.append(_error_mm(np.exp(-z / model.focal_px), depth, given[1]))
        figures += [None] * quick
        own = costs(ours.SURFACE, model, normals)
        peer = costs(xie2014.PEER, "sight", given)
        for one in (own, peer):
            figures += [one.fit_cpu_s + one.run_cpu_s, one.peak_mb]
        rows[name] = figures
    return Table(
        "surfaces",
        "DiLiGenT: mean error of depth from the given normals, in mm",
        ("this program", "smooth", "Xie, along the line of sight", "Xie, to nearest points",
         "this program, CPU s", "MB", "Xie, along the line of sight, CPU s", "MB of it"),
        rows,
        "Over every pixel of the mask, after scaling by the median. The normals are not those of a "
        "single surface where one part hides another (goblet): only surfaces with jumps can follow "
        "them. Memory is the peak above the inputs, in a process of its own. The paper states "
        "neither errors nor costs of this step.",
    )  # fmt: skip
