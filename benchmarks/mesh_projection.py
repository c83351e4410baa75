"""First hits of camera rays: on meshes by a tree, on height fields by Newton's method and marching.

Times are the minimum CPU seconds of three runs with warm caches, of all threads together. "tree s"
is the construction of a mesh's tree, "trace s" finds the first hits, "blocked s" tests for every
hit whether a light is hidden. "copies" is the time of tracing relative to one copy of the rays in
memory; "MB" is its peak of resident memory.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import trimesh
from harness import Cost, command_line, copy_s, measured

from simulator.shapes import (
    BandNoise,
    Coin,
    CrackedLeather,
    LizardScales,
    MeshBody,
    Ripples,
    SphericalCap,
    StepGauge,
    Textile,
    WoodCarving,
)

EYE, LAMP = np.array([0.0, 0.0, 600.0]), np.array([250.0, 120.0, 350.0])


def warm(work: Callable[[], object]) -> Cost:
    work()
    return measured(work, runs=3)[0]


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("mesh", nargs="*", help="mesh files; default: a ball of 80 k faces")
    parser.add_argument("--pixels", type=int, default=1_000_000, help="number of rays")
    options = parser.parse_args()
    side = round(options.pixels**0.5)
    across = (np.arange(side) - (side - 1) / 2) / side * 0.29
    x, y = np.meshgrid(across, -across)
    rays = np.stack([x, y, np.full_like(x, -1.0)], axis=-1)
    copy = copy_s(rays)
    print(f"{side} x {side} rays, one copy {1e3 * copy:.1f} ms")
    print(
        f"{'body':24} {'faces':>7} {'tree s':>7} {'trace s':>8} {'copies':>7} {'MB':>7} "
        f"{'blocked s':>9}"
    )
    if options.mesh:
        bodies = [MeshBody.read(path, radius_mm=80.0) for path in options.mesh]
    else:
        ball = trimesh.creation.icosphere(subdivisions=6, radius=70.0)
        vertices = np.asarray(ball.vertices) + np.array([0.0, 0.0, 70.0])
        bodies = [MeshBody(vertices, np.asarray(ball.faces), name="ball")]
    for body in bodies:
        grown = warm(partial(type(body.tree).grow, body.vertices_mm[body.faces]))
        trace = warm(partial(body.trace, EYE, rays))
        hits = body.trace(EYE, rays)
        points = (hits.points_mm + 1e-3 * hits.normals)[hits.hit]
        shadow = warm(partial(body.tree.blocked, points, LAMP - points))
        print(
            f"{body.name[-24:]:24} {len(body.faces):7} {grown.cpu_s:7.2f} {trace.cpu_s:8.2f} "
            f"{trace.cpu_s / copy:7.0f} {trace.peak_mb:7.0f} {shadow.cpu_s:9.2f}"
        )
    fields = [
        kind(80.0)
        for kind in (
            Coin, Ripples, BandNoise, LizardScales, Textile, CrackedLeather, WoodCarving, StepGauge,
        )
    ]  # fmt: skip
    for field in (*fields, SphericalCap(80.0, 80.0)):
        trace = warm(partial(field.trace, EYE, rays))
        print(
            f"{type(field).__name__:24} {'':7} {'':7} {trace.cpu_s:8.2f} {trace.cpu_s / copy:7.0f} "
            f"{trace.peak_mb:7.0f}"
        )


if __name__ == "__main__":
    main()
