"""
Where a surface differs from its normals
========================================

`processing.normal_residual` compares the normals of a surface with those it was computed from.
Use it to see where no surface fits, for example at steps.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, integrate, normal_residual
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

surface = integrate(coin, camera=truth.camera)
angles = normal_residual(surface, coin)

plt.figure(figsize=(5, 3.6), layout="constrained")
plt.imshow(angles, cmap="magma", vmax=5)
plt.colorbar(label="angle in degrees")
plt.axis("off")
plt.show()
