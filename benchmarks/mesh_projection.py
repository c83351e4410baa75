"""First hits of camera rays: meshes by the tree, height fields by Newton's method and the march.

python benchmarks/mesh_projection.py [--pixels 1000000] [MESH ...]

Warm caches, CPU seconds of all threads. "blocked" asks for every hit whether a lamp is hidden.
"copies" relates the time to one copy of the rays in memory.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import trimesh

from simulator._shapes.carved import CrackedLeather, LizardScales, StepGauge, Textile, WoodCarving
from simulator._shapes.coin import Coin
from simulator._shapes.mesh import MeshBody
from simulator._shapes.surface import BandNoise, Ripples, SphericalCap

EYE, LAMP = np.array([0.0, 0.0, 600.0]), np.array([250.0, 120.0, 350.0])


def cpu_s(work: Callable[[], object], times: int = 3) -> float:
    work()
    spent = []
    for _ in range(times):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mesh", nargs="*", help="mesh files; a ball of 80 k faces without any")
    parser.add_argument("--pixels", type=int, default=1_000_000)
    given = parser.parse_args()
    side = round(given.pixels**0.5)
    across = (np.arange(side) - (side - 1) / 2) / side * 0.29
    x, y = np.meshgrid(across, -across)
    rays = np.stack([x, y, np.full_like(x, -1.0)], axis=-1)
    copy = cpu_s(rays.copy)
    print(f"{side} x {side} rays, one copy {1e3 * copy:.1f} ms")
    print(f"{'body':24} {'faces':>7} {'tree s':>7} {'trace s':>8} {'copies':>7} {'blocked s':>9}")
    if given.mesh:
        bodies = [MeshBody.read(path, radius_mm=80.0) for path in given.mesh]
    else:
        ball = trimesh.creation.icosphere(subdivisions=6, radius=70.0)
        vertices = np.asarray(ball.vertices) + np.array([0.0, 0.0, 70.0])
        bodies = [MeshBody(vertices, np.asarray(ball.faces), name="ball")]
    for body in bodies:
        grown = cpu_s(lambda body=body: type(body.tree).grow(body.vertices_mm[body.faces]))
        trace = cpu_s(lambda body=body: body.trace(EYE, rays))
        hits = body.trace(EYE, rays)
        points = (hits.points_mm + 1e-3 * hits.normals)[hits.hit]
        shadow = cpu_s(lambda body=body, p=points: body.tree.blocked(p, LAMP - p))
        print(
            f"{body.name[-24:]:24} {len(body.faces):7} {grown:7.2f} {trace:8.2f} "
            f"{trace / copy:7.0f} {shadow:9.2f}"
        )
    for kind in (
        Coin, Ripples, BandNoise, LizardScales, Textile, CrackedLeather, WoodCarving, StepGauge,
    ):  # fmt: skip
        field = kind(80.0)
        trace = cpu_s(lambda field=field: field.trace(EYE, rays))
        print(f"{kind.__name__:24} {'':7} {'':7} {trace:8.2f} {trace / copy:7.0f}")
    cap = SphericalCap(80.0, 80.0)
    print(f"{'half sphere':24} {'':7} {'':7} {cpu_s(lambda: cap.trace(EYE, rays)):8.2f}")


if __name__ == "__main__":
    main()
