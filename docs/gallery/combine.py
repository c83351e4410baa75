"""
Put shape and detail together
=============================

`processing.combine` is the inverse of `processing.separate`. Use it after you edited the
detail; here the detail of the right half is removed.
"""

import matplotlib.pyplot as plt
import numpy as np

from processing import NormalMap, angular_error, combine, separate
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

parts = separate(coin)
print(f"{angular_error(combine(parts.shape, parts.detail), coin).mae_deg:.1e} degrees")

edited = parts.detail.normals.copy()
edited[:, 100:][coin.mask[:, 100:]] = (0, 0, 1)  # no detail
smooth = combine(parts.shape, NormalMap(edited, coin.mask))
light = np.array([-0.5, 0.5, 0.7])

plt.figure(figsize=(5, 4), layout="constrained")
plt.imshow(np.clip(smooth.normals @ light, 0, None), cmap="gray")
plt.axis("off")
plt.show()
