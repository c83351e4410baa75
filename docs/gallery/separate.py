"""
Split a map into shape and detail
=================================

`processing.separate` splits normals into a smooth shape and the detail relative to it. Use it
to look at fine relief on a curved surface, or to edit one without the other.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, separate
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

parts = separate(coin)
print(f"shape left in the detail: {parts.separability_deg:.2f} degrees")

figure, axes = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained")
maps = {"normals": coin, "shape": parts.shape, "detail": parts.detail}
for axis, (title, one) in zip(axes, maps.items(), strict=True):
    axis.imshow((one.normals + 1) / 2)
    axis.set_title(title)
    axis.axis("off")
plt.show()
