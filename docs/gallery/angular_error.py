"""
Compare two normal maps
=======================

`processing.angular_error` measures the angle between two maps at every pixel. Use it against a
ground truth: a pixel without a normal counts as 90 degrees.
"""

import matplotlib.pyplot as plt
import numpy as np

from processing import NormalMap, angular_error
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

noise = np.random.default_rng(0).normal(scale=0.02, size=coin.normals.shape)
noisy = NormalMap.from_vectors(coin.normals + noise, coin.mask)
error = angular_error(noisy, coin)
print(f"mean {error.mae_deg:.2f}, median {error.median_deg:.2f} degrees")

plt.figure(figsize=(5, 3.6), layout="constrained")
plt.imshow(error.map_deg, cmap="magma")
plt.colorbar(label="error in degrees")
plt.axis("off")
plt.show()
