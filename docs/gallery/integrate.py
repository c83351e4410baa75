"""
Height from normals
===================

`processing.integrate` finds the surface that fits a normal map best. Use it for heights, meshes
and prints; without ``pixel_mm`` or a camera, the unit is pixels.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, integrate
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

surface = integrate(coin, camera=truth.camera)
print(surface)

plt.figure(figsize=(5, 3.6), layout="constrained")
plt.imshow(surface.height)
plt.colorbar(label="height in mm")
plt.axis("off")
plt.show()
