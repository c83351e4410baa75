"""
Write a mesh
============

`processing.write_mesh` writes a surface as PLY, OBJ, STL or GLB. Use the suffix that your
program reads; every file names its unit.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from processing import NormalMap, integrate, write_mesh
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

surface = integrate(coin, camera=truth.camera)
folder = Path(tempfile.mkdtemp())
sizes = {}
for suffix in ("ply", "obj", "stl", "glb"):
    path, *others = write_mesh(folder / f"coin.{suffix}", surface, normals=coin)
    sizes[path.name] = path.stat().st_size / 1e6

plt.figure(figsize=(5, 3), layout="constrained")
plt.barh([*sizes], [*sizes.values()])
plt.xlabel("size in MB")
plt.show()
