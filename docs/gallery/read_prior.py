"""
Use heights that are known
==========================

`processing.surface.read_prior` reads known heights, such as those of a touch probe. Use it to
correct the slow bend that normals alone leave; here tilted normals bend the surface.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from processing import NormalMap, integrate
from processing.surface import read_prior
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

tilted = NormalMap.from_vectors(coin.normals + np.array([0.03, 0, 0]), coin.mask)
places = [(60, 60), (140, 60), (60, 110), (140, 110), (100, 40)]
rows = [f"{x},{y},{truth.height_mm[y, x]:.3f}" for x, y in places]
path = Path(tempfile.mkdtemp()) / "points.csv"
path.write_text("\n".join(["x_px,y_px,height_mm", *rows, ""]))
prior = read_prior(path, truth.size, unit="mm", sigma=0.01)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for axis, known in zip(axes, (None, prior), strict=True):
    surface = integrate(tilted, camera=truth.camera, prior=known)
    error = surface.height - truth.height_mm
    picture = axis.imshow(error, cmap="coolwarm", vmin=-4, vmax=4)
    axis.set_title("error without points" if known is None else "error with five points")
    axis.axis("off")
figure.colorbar(picture, ax=axes, label="mm")
plt.show()
