"""
Photometric stereo of arrays
============================

`processing.photometric_stereo` computes normals and albedo from arrays. Use it for images that
are already in memory and linear.
"""

import matplotlib.pyplot as plt

from processing import photometric_stereo
from simulator import render, scene_named

view = render(scene_named("ripples", width=160, height=128, leds=12))
truth = view.truth
values = view.planes / view.planes.max()
result = photometric_stereo(values, truth.lights, truth.mask, points_mm=truth.points_mm)
print(result)

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
left.imshow((result.normal_map.normals + 1) / 2)
picture = right.imshow(result.residual, cmap="magma")
figure.colorbar(picture, label="residual, 1 is white")
for axis in (left, right):
    axis.axis("off")
plt.show()
