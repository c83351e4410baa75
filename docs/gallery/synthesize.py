"""
Continue a detail over any area
===============================

`processing.synthesize` continues a detail by patches of it. Use it for sheets that are larger
than what was recorded; with ``tileable`` the sheet can be repeated.
"""

import matplotlib.pyplot as plt

from processing import NormalMap, separate, synthesize
from simulator import render, scene_named

truth = render(scene_named("scales", width=200, height=160, leds=4)).truth
exemplar = separate(NormalMap(truth.normals, truth.mask)).detail
sheet = synthesize(exemplar, (200, 300), tileable=True)
print(sheet)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for axis, one in zip(axes, (exemplar, sheet.detail), strict=True):
    axis.imshow((one.normals + 1) / 2)
    axis.axis("off")
plt.show()
