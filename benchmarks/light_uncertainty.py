"""Compare errors of light positions with their covariances, over seeds of simulated observations.

Each seed draws spheres, the edge points of their outlines and the highlights of 36 lights: edge
errors of 0.3 px smoothed along the outline by 4 px, systematic errors of 0.03 px of position and
radius of each outline, of which the radii have half of the variance in common, and highlight errors
with standard deviations between 0.03 and 0.3 px. The columns are the mean error, the reduced
chi-square along X, Y and Z, that of all three, and the number of seeds whose worst of 36 lights
exceeds the 99.9 % quantile of the largest of 36. `light_accuracy.py` does the same with rendered
images.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from harness import command_line
from scipy.ndimage import gaussian_filter1d
from scipy.stats import chi2

from acquisition import CameraModel
from calibration.spheres.outline.outline_noise import viewing_cone
from calibration.spheres.solve.joint_refinement import Observation, predicted_highlights
from calibration.spheres.solve.light_positions import LocatedLights, locate_lights
from calibration.spheres.solve.sphere_positions import place
from rig.arrays import Float64

EDGE_PX, ALONG_PX, SYSTEMATIC_PX = 0.3, 4.0, 0.03
# Share of the variance of the radius error that all outlines of a seed have in common.
COMMON_SHARE = 0.5
COMMON_PX = COMMON_SHARE**0.5 * SYSTEMATIC_PX
HIGHLIGHT_PX = (0.03, 0.3)
QUANTILE = 0.999


@dataclass(frozen=True)
class Layout:
    """Spheres in the field of the camera."""

    name: str
    count: int
    radii_mm: tuple[float, ...]


LAYOUTS = (
    Layout("2 x R10", 2, (10.0,)),
    Layout("2 x R20", 2, (20.0,)),
    Layout("4 x R20", 4, (20.0,)),
    Layout("5, R10 to R20", 5, (10.0, 14.0, 20.0)),
)


def camera() -> CameraModel:
    k = np.array([[5000.0, 0, 1223.5], [0, 5000.0, 1023.5], [0, 0, 1]])
    return CameraModel(k, 2448, 2048, 600.0)


def dome(count: int = 36, radius_mm: float = 450.0) -> Float64:
    """Return lights on rings at elevations of 15, 35, 55 and 75 degrees."""
    elevations = np.radians([15, 35, 55, 75])
    share = np.cos(elevations) / np.cos(elevations).sum()
    counts = np.diff(np.round(count * np.cumsum(share)).astype(int), prepend=0)
    places = []
    for elevation, n in zip(elevations, counts, strict=True):
        turn = np.arange(n) * 2 * np.pi / n + 0.3
        flat = np.cos(elevation)
        places.append(
            np.column_stack(
                [flat * np.cos(turn), flat * np.sin(turn), np.full(n, np.sin(elevation))]
            )
        )
    return radius_mm * np.concatenate(places)


def spheres(layout: Layout, rng: np.random.Generator) -> tuple[Float64, Float64]:
    """Return centres and radii of spheres on the plane that do not touch, in the camera's field."""
    while True:
        radii = rng.choice(layout.radii_mm, layout.count)
        centres = np.column_stack(
            [rng.uniform(-115, 115, layout.count), rng.uniform(-90, 90, layout.count), radii]
        )
        gaps = np.linalg.norm(centres[:, None] - centres[None], axis=-1) + 1e9 * np.eye(len(radii))
        # Two spheres that nearly touch do not determine positions; users put them apart.
        if gaps.min() > (120 if layout.count == 2 else 60):
            return centres, radii


def outline_points(
    model: CameraModel,
    centre: Float64,
    radius: float,
    rng: np.random.Generator,
    common_px: float = 0.0,
) -> Float64:
    """Return the pixels of edge points with errors along the normals of the outline.

    ``common_px`` is the error of the radius that all outlines share.
    """
    axis = centre - model.centre_mm
    distance = float(np.linalg.norm(axis))
    axis = axis / distance
    first = np.cross(axis, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    turn = np.arange(int(2 * np.pi * radius / distance * model.focal_px))
    turn = turn * (2 * np.pi / len(turn))
    ring = radius * np.sqrt(1 - (radius / distance) ** 2)
    circle = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    points = model.project(
        model.centre_mm + (distance - radius**2 / distance) * axis + ring * circle
    )
    normals = points - points.mean(axis=0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    noise = gaussian_filter1d(rng.normal(0, 1, len(points)), ALONG_PX, mode="wrap")
    noise *= EDGE_PX * np.sqrt(2 * np.sqrt(np.pi) * ALONG_PX)
    x, y, r = rng.normal(0, SYSTEMATIC_PX, 3)
    r = common_px + np.sqrt(1 - COMMON_SHARE) * r
    off: Float64 = points + (noise + r)[:, None] * normals + np.array([x, y])
    return off


def observe(layout: Layout, seed: int, stated: float = 1.0) -> tuple[LocatedLights, Float64]:
    """Return lights located from simulated observations, and their true positions.

    The standard deviations of highlights are stated as so many times those of their errors.
    """
    rng = np.random.default_rng(seed)
    model, truth = camera(), dome()
    centres, radii = spheres(layout, rng)
    common_px = rng.normal(0, COMMON_PX)
    cones = [
        viewing_cone(model.rays(outline_points(model, c, r, rng, common_px)), 1 / model.focal_px)
        for c, r in zip(centres, radii, strict=True)
    ]
    highlights = predicted_highlights(model, centres, radii, truth)
    sigma_px = np.exp(rng.uniform(*np.log(HIGHLIGHT_PX), highlights.shape[:2]))
    highlights = highlights + rng.normal(0, 1, highlights.shape) * sigma_px[..., None]
    ids = tuple(f"L{i:02d}" for i in range(len(truth)))
    placed = place(cones, radii, model)
    seen = Observation(model, placed, highlights, stated * sigma_px)
    return locate_lights(seen, ids, peaks=True), truth


@dataclass(frozen=True, eq=False)
class Figures:
    """Statistics over the seeds of a layout."""

    error_mm: float
    by_axis: Float64
    together: float
    beyond: int


def simulated(layout: Layout, seed: int, stated: float = 1.0) -> tuple[Float64, Float64]:
    located, truth = observe(layout, seed, stated)
    return located.refined.positions_mm - truth, located.refined.covariance_mm2


def figures(trial: Callable[[int], tuple[Float64, Float64]], seeds: range) -> Figures:
    limit = chi2.ppf(QUANTILE ** (1 / 36), 3)
    errors, shares, squares = [], [], []
    for seed in seeds:
        error, covariance = trial(seed)
        errors.append(np.linalg.norm(error, axis=1).mean())
        shares.append(error**2 / np.diagonal(covariance, axis1=1, axis2=2))
        solved = np.linalg.solve(covariance, error[..., None])[..., 0]
        squares.append(np.sum(error * solved, axis=1))
    return Figures(
        float(np.mean(errors)),
        np.mean(shares, axis=(0, 1)),
        float(np.mean(squares) / 3),
        int(np.sum(np.max(squares, axis=1) > limit)),
    )


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument(
        "--stated", type=float, default=1.0, help="stated errors of highlights, relative to theirs"
    )
    options = parser.parse_args()
    print("spheres         error mm   chi2 X     Y     Z   all   worst beyond   CPU s")
    for layout in LAYOUTS:
        start = time.process_time()
        result = figures(
            partial(simulated, layout, stated=options.stated),
            range(options.first, options.first + options.seeds),
        )
        x, y, z = result.by_axis
        print(
            f"{layout.name:14} {result.error_mm:9.2f} {x:8.2f} {y:5.2f} {z:5.2f} "
            f"{result.together:5.2f} {result.beyond:8} of {options.seeds}"
            f" {time.process_time() - start:8.1f}"
        )


if __name__ == "__main__":
    main()
