"""
Where normals contradict each other
===================================

`processing.normal_curl` measures by how much normals are not those of a surface. Use it to find
calibration errors: here a part of the map has its green channel inverted.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, normal_curl
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

wrong = coin.normals.copy()
wrong[100:, :, 1] *= -1
for name, normals in (("right", coin.normals), ("wrong", wrong)):
    found = normal_curl(NormalMap(normals, coin.mask))
    print(f"{name}: {found.spread_deg:.2f} degrees")

plt.figure(figsize=(5, 3.6), layout="constrained")
plt.imshow(found.curl_deg, cmap="coolwarm", vmin=-5, vmax=5)
plt.colorbar(label="curl in degrees")
plt.axis("off")
plt.show()
