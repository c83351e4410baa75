"""
Lights from chrome spheres
==========================

`calibration.calibrate_spheres` finds mirror spheres and the lights in them. Use it once per
setup: with a camera and the radii of two or more spheres, lights get positions.
"""

import matplotlib.pyplot as plt
import numpy as np

from calibration import calibrate_spheres
from simulator import render, scene_named

view = render(scene_named("spheres", width=480, height=384, leds=8))
images = (view.planes / view.planes.max()).astype(np.float32)
estimate = calibrate_spheres(images, camera=view.truth.camera, radius_mm=(20, 20, 16, 14))
for sphere in estimate.spheres:
    print(sphere)
error_mm = np.linalg.norm(estimate.lights.positions_mm - view.truth.lights.positions_mm, axis=1)
print(f"positions are wrong by {error_mm.mean():.1f} mm")

plt.figure(figsize=(6, 4.8), layout="constrained")
plt.imshow(images[0], cmap="gray", vmax=np.percentile(images[0], 99.5))
plt.plot(*estimate.highlights_px[0].T, "o", color="tab:orange", fillstyle="none")
plt.title("the first light, mirrored in every sphere")
plt.axis("off")
plt.show()
