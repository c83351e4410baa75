"""Cost of meshes: writing, simplifying and closing a surface of five million vertices.

The surface is a relief of waves on a bowl. "close" writes the solid as STL, "simplify" the mesh as
PLY. Each line is a process of its own: CPU seconds, the highest memory above that of the height map
and its normals, and both as multiples of the file. The yardstick is a copy of the same bytes into a
file with fsync.

    python benchmarks/meshes.py --side 2236
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from harness import peak_begins, resident_bytes

from processing import HeightMap, NormalMap, height_mesh, integrate, solid_mesh, write_mesh

TASKS = ("copy", "ply", "glb", "stl", "obj", "simplify 1/20", "close")
MIB = 1 << 20


def relief(side: int) -> tuple[NormalMap, HeightMap]:
    """Return waves on a bowl, with its height map."""
    y, x = np.mgrid[1 : -1 : side * 1j, -1 : 1 : side * 1j].astype(np.float32)
    height = side / 2 * (0.05 * np.sin(9 * x) * np.cos(7 * y) + 0.2 * (x * x + y * y))
    down, right = np.gradient(height)
    normal_map = NormalMap.from_vectors(np.dstack([-right, down, np.ones_like(x)]))
    return normal_map, integrate(normal_map, pixel_mm=0.05)


def carry_out(task: str, side: int, folder: Path) -> None:
    """Measure one task and print its line."""
    small, small_surface = relief(64)
    write_mesh(folder / "warm.ply", small_surface, normals=small)
    normal_map, surface = relief(side)
    vertices = int(np.count_nonzero(surface.mask))
    data = np.random.default_rng(0).bytes(50 * vertices) if task == "copy" else b""
    before, start = peak_begins(), time.process_time()
    size = 0
    if task == "copy":
        with (folder / "copy").open("wb") as file:
            file.write(data)
            os.fsync(file.fileno())
        size = len(data)
    elif task == "close":
        solid = solid_mesh(height_mesh(surface))
        (path,) = write_mesh(folder / "solid.stl", surface, mesh=solid)
        size = path.stat().st_size
    elif task.startswith("simplify"):
        count = len(height_mesh(surface).faces) // 20
        simple = height_mesh(surface, normals=normal_map, triangles=count)
        (path,) = write_mesh(folder / "simple.ply", surface, mesh=simple)
        size = path.stat().st_size
    else:
        (path,) = write_mesh(folder / f"a.{task}", surface, normals=normal_map)
        size = path.stat().st_size
    seconds, more = time.process_time() - start, resident_bytes("VmHWM") - before
    print(
        f"{task:14s} {vertices / 1e6:.2f} M vertices  {seconds:6.2f} CPU s  {size / 1e6:6.0f} MB  "
        f"memory {more / MIB:6.0f} MiB = {more / max(size, 1):.2f} x the file",
        flush=True,
    )


def main() -> None:
    """Measure each task in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=2236, help="vertices along each side")
    parser.add_argument("--tasks", nargs="*", choices=TASKS, default=TASKS)
    parser.add_argument("--here", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.here is not None:
        with tempfile.TemporaryDirectory() as folder:
            carry_out(options.here, options.side, Path(folder))
        return
    for task in options.tasks:
        words = [sys.executable, __file__, "--side", str(options.side), "--here", task]
        subprocess.run(words, check=True)


if __name__ == "__main__":
    main()
