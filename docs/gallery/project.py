"""
A mesh as a normal map
======================

`processing.project` draws a mesh or a point cloud as normals, mask and height. Use it to bring
the detail of a scan, or of a model, to a photographed surface.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from processing import NormalMap, integrate, project, read_geometry, write_mesh
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

path, *_ = write_mesh(Path(tempfile.mkdtemp()) / "coin.ply", integrate(coin, pixel_mm=1))
view = project(read_geometry(path), size=(300, 300))
print(view)

plt.figure(figsize=(4, 4), layout="constrained")
plt.imshow((view.normal_map.normals + 1) / 2)
plt.axis("off")
plt.show()
