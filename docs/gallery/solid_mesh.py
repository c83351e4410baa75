"""
A solid to print
================

`processing.solid_mesh` closes a surface with walls and a flat base. Use it for printers and
CAD, which need watertight bodies.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, height_mesh, integrate, solid_mesh
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

surface = integrate(coin, camera=truth.camera)
solid = solid_mesh(height_mesh(surface, triangles=4000), base=5.0)
print(f"{len(solid.faces)} triangles")

axis = plt.figure(figsize=(6, 4), layout="constrained").add_subplot(projection="3d")
x, y, z = solid.vertices.T
axis.plot_trisurf(x, y, z, triangles=solid.faces, color="lightsteelblue")
axis.set_box_aspect((1, 1, 0.3))
axis.view_init(25, -70)
plt.show()
