"""
Enlarge a normal map
====================

`processing.super_resolve` enlarges a map with a small network, and says how sure it is. Use it
for display; what it adds is invented.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, super_resolve
from simulator import render, scene_named

truth = render(scene_named("woodcarving", width=96, height=76, leds=4)).truth
small = NormalMap(truth.normals, truth.mask)
large = super_resolve(small, 2, sampling="points")
print(large)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
for axis, one in zip(axes, (small, large.normal_map), strict=True):
    axis.imshow((one.normals + 1) / 2, interpolation="nearest")
    axis.axis("off")
plt.show()
