"""
Fill holes
==========

`processing.fill_holes` fills missing parts of a map from their surroundings. Use it for damage
and gaps in a surface; what it adds is invented, not measured.
"""

import matplotlib.pyplot as plt
import numpy as np

from processing import NormalMap, fill_holes
from simulator import render, scene_named

truth = render(scene_named("scales", width=200, height=160, leds=4)).truth
scales = NormalMap(truth.normals, truth.mask)
y, x = np.mgrid[:160, :200]
holes = np.hypot(x - 85, y - 75) < 14
filled = fill_holes(scales, holes)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
axes[0].imshow((np.where(holes[..., None], 0, scales.normals) + 1) / 2)
axes[1].imshow((filled.normal_map.normals + 1) / 2)
for axis in axes:
    axis.axis("off")
plt.show()
