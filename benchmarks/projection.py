"""Projection of meshes and point clouds to normal maps: CPU seconds, copies of the image, memory.

Each row is measured in a process of its own with warm caches; CPU seconds are those of all threads.
"camera" is a perspective view; "shuffled" has its faces in random order, unlike the files of any
scanner or modelling program. "copies" is the time relative to one copy of the normal map; "MB" is
the growth of the peak memory after the mesh is loaded (on Linux).
"""

from __future__ import annotations

import numpy as np
from harness import Cost, alone, command_line, copy_s, measured

from acquisition import CameraModel
from processing import Geometry, project
from rig.arrays import Float64


def bumpy_ball(faces: int) -> Geometry:
    n = max(round((faces / 2) ** 0.5), 4)
    polar = np.linspace(0.01, np.pi - 0.01, n + 1)[:, None]
    around = np.linspace(0, 2 * np.pi, n, endpoint=False)[None]
    radius = 50 * (1 + 0.02 * np.sin(40 * polar) * np.sin(40 * around))
    point = [np.sin(polar) * np.sin(around), np.cos(polar) + 0 * around]
    point.append(np.sin(polar) * np.cos(around))
    vertices = (radius[..., None] * np.stack(point, axis=-1)).reshape(-1, 3)
    number = np.arange((n + 1) * n).reshape(n + 1, n)
    a, b = number[:-1], np.roll(number, -1, axis=1)[:-1]
    c, d = number[1:], np.roll(number, -1, axis=1)[1:]
    quads = np.stack([a, c, b, b, c, d], axis=-1)
    return Geometry(vertices, quads.reshape(-1, 3))


def shuffled(mesh: Geometry) -> Geometry:
    order = np.random.default_rng(0).permutation(len(mesh.faces))
    return Geometry(mesh.vertices, mesh.faces[order])


def on_the_ball(points: int) -> Geometry:
    vectors: Float64 = np.random.default_rng(0).normal(size=(points, 3))
    return Geometry(50 * vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


KINDS = {
    "mesh": bumpy_ball,
    "mesh, camera": bumpy_ball,
    "mesh, shuffled": lambda faces: shuffled(bumpy_ball(faces)),
    "points": on_the_ball,
}


def perspective(side: int) -> CameraModel:
    middle = (side - 1) / 2
    K = np.array([[2.5 * side, 0, middle], [0, 2.5 * side, middle], [0, 0, 1]])
    return CameraModel(K, side, side, 300.0)


def measure(kind: str, count: int, side: int) -> tuple[Cost, int, float]:
    """Return the cost, the number of drawn faces or points, and the share of covered pixels."""
    camera = perspective(side) if kind == "mesh, camera" else None
    project(KINDS[kind](2000), size=(side, side), camera=camera)  # compiles
    geometry = KINDS[kind](count)
    cost, seen = measured(lambda: project(geometry, size=(side, side), camera=camera))
    drawn = geometry.vertices if geometry.faces is None else geometry.faces
    return cost, len(drawn), float(seen.normal_map.mask.mean())


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--faces", type=int, nargs="+", default=[500_000, 5_000_000], help="faces of the meshes"
    )
    parser.add_argument(
        "--points", type=int, nargs="+", default=[100_000], help="points of the clouds"
    )
    parser.add_argument("--size", type=int, default=2000, help="side of the square image in pixels")
    options = parser.parse_args()
    copy = copy_s(np.ones((options.size, options.size, 3), np.float32))
    print(
        f"{'':16} {'faces':>9} {'side':>6} {'covered':>7} {'CPU s':>7} {'wall s':>7} {'copies':>7} "
        f"{'MB':>6}"
    )
    rows = [(kind, count) for count in options.faces for kind in KINDS if kind != "points"]
    rows += [("points", count) for count in options.points]
    for kind, count in rows:
        cost, drawn, covered = alone(measure, kind, count, options.size)
        print(
            f"{kind:16} {drawn:9,d} {options.size:6d} {covered:7.2f} {cost.cpu_s:7.2f} "
            f"{cost.wall_s:7.2f} {cost.cpu_s / copy:7.0f} {cost.peak_mb:6.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
