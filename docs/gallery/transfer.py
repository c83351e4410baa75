"""
Transfer detail to another shape
================================

`processing.transfer` puts the detail of one map on the shape of another. Use it to give a
surface the texture of another one; the result knows its errors.
"""

import matplotlib.pyplot as plt
import numpy as np

from processing import NormalMap, transfer
from simulator import render, scene_named


def normals_of(name):
    truth = render(scene_named(name, width=200, height=160, leds=4)).truth
    return NormalMap(truth.normals, truth.mask)


coin, leather = normals_of("coin"), normals_of("leather")
moved = transfer(leather, coin)
print(f"error of the shape: {moved.fidelity.shape_mae_deg:.2f} degrees")
light = np.array([-0.5, 0.5, 0.7])

figure, axes = plt.subplots(1, 3, figsize=(10, 2.8), layout="constrained")
maps = {"leather": leather, "coin": coin, "leather on the coin": moved.normal_map}
for axis, (title, one) in zip(axes, maps.items(), strict=True):
    axis.imshow(np.clip(one.normals @ light, 0, None), cmap="gray")
    axis.set_title(title)
    axis.axis("off")
plt.show()
