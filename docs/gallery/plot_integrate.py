"""
Height from normals
===================

`processing.integrate` finds the surface that fits a normal map best. Use it when you need
heights, a mesh or a print.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, integrate
from simulator import render, scene_named

truth = render(scene_named("coin", width=160, height=128, leds=4)).truth
surface = integrate(NormalMap(truth.normals, truth.mask), pixel_mm=0.5)
print(surface)

plt.imshow(surface.height, cmap="gray")
plt.colorbar(label="height in mm")
plt.axis("off")
plt.show()
