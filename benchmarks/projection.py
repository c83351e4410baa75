"""Meshes and point clouds to normal maps: CPU seconds, copies of the image, memory.

python benchmarks/projection.py [--faces 500000 5000000] [--points 100000] [--size 2000]

Each row in a process of its own, warm caches, CPU seconds of all threads. "camera" is seen in
perspective; "shuffled" has its faces in random order, which no scanner or modeller writes. "copies"
relates the time to one copy of the normal map; "MB" is the peak above what was resident with the
mesh loaded (on Linux).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

from acquisition import CameraModel
from processing import Geometry, project

RESET_PEAK = Path("/proc/self/clear_refs")


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
    found: npt.NDArray[np.float64] = np.random.default_rng(0).normal(size=(points, 3))
    return Geometry(50 * found / np.linalg.norm(found, axis=1, keepdims=True))


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


def resident_bytes(entry: str) -> int:
    status = Path("/proc/self/status").read_text()
    line = next(line for line in status.splitlines() if line.startswith(entry))
    return int(line.split()[1]) * 1024


def measure(kind: str, count: int, side: int) -> str:
    camera = perspective(side) if kind == "mesh, camera" else None
    project(KINDS[kind](2000), size=(side, side), camera=camera)
    normals = np.ones((side, side, 3), np.float32)
    normals.copy()
    begin = time.process_time()
    for _ in range(5):
        normals.copy()
    copy = (time.process_time() - begin) / 5
    del normals
    geometry = KINDS[kind](count)
    before = resident_bytes("VmRSS")
    RESET_PEAK.write_text("5")
    cpu, wall = time.process_time(), time.perf_counter()
    seen = project(geometry, size=(side, side), camera=camera)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    peak = (resident_bytes("VmHWM") - before) / 1e6
    drawn = len(geometry.vertices if geometry.faces is None else geometry.faces)
    share = seen.normal_map.mask.mean()
    return (
        f"{kind:16} {drawn:9,d} {side:6d} {share:7.2f} {cpu:7.2f} {wall:7.2f} {cpu / copy:7.0f} "
        f"{peak:6.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faces", type=int, nargs="+", default=[500_000, 5_000_000])
    parser.add_argument("--points", type=int, nargs="+", default=[100_000])
    parser.add_argument("--size", type=int, default=2000, help="side of the square image in pixels")
    parser.add_argument("--row", nargs=2, help="this kind and count alone, in this process")
    options = parser.parse_args()
    if options.row:
        print(measure(options.row[0], int(options.row[1]), options.size), flush=True)
        return
    print(
        f"{'':16} {'faces':>9} {'side':>6} {'covered':>7} {'CPU s':>7} {'wall s':>7} {'copies':>7} "
        f"{'MB':>6}"
    )
    rows = [(kind, count) for count in options.faces for kind in KINDS if kind != "points"]
    rows += [("points", count) for count in options.points]
    for kind, count in rows:
        call = [sys.executable, __file__, "--row", kind, str(count), "--size", str(options.size)]
        # Freed blocks go back to the system at once, else they would hide what is used.
        subprocess.run(call, check=True, env=os.environ | {"MALLOC_MMAP_THRESHOLD_": "65536"})


if __name__ == "__main__":
    main()
