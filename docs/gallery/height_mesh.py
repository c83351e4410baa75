"""
A mesh with few triangles
=========================

`processing.height_mesh` turns heights into triangles, and removes those that matter least. Use
it before you give a surface to a program for meshes.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, height_mesh, integrate
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

surface = integrate(coin, camera=truth.camera)
print(f"{len(height_mesh(surface).faces)} triangles in the complete mesh")
mesh = height_mesh(surface, triangles=1500)
print(f"{len(mesh.faces)} triangles are left")

plt.figure(figsize=(5, 4.6), layout="constrained")
plt.triplot(mesh.vertices[:, 0], mesh.vertices[:, 1], mesh.faces, linewidth=0.4)
plt.axis("equal")
plt.xlabel("x in mm")
plt.ylabel("y in mm")
plt.show()
