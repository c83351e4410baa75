"""
Use heights that are known
==========================

`processing.surface.read_prior` reads known heights: points of a touch probe, or a coarse scan. Use
it to correct the slow bend that normals alone leave; here tilted normals bend the surface.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from processing import NormalMap, integrate
from processing.surface import read_prior
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
tilted = NormalMap.from_vectors(truth.normals + np.array([0.03, 0, 0]), truth.mask)
path = Path(tempfile.mkdtemp()) / "scan.npy"
np.save(path, truth.height_mm.reshape(20, 8, 25, 8).mean(axis=(1, 3)).astype(np.float32))
prior = read_prior(path, truth.size, unit="mm", sigma=0.01)

figure, axes = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
for axis, known in zip(axes, (None, prior), strict=True):
    surface = integrate(tilted, camera=truth.camera, prior=known)
    error = surface.height - truth.height_mm
    error -= np.nanmean(error)
    print(f"{np.nanstd(error):.2f} mm")
    picture = axis.imshow(error, cmap="coolwarm", vmin=-3, vmax=3)
    axis.set_title("error with normals only" if known is None else "error with a coarse scan")
    axis.axis("off")
figure.colorbar(picture, ax=axes, label="mm")
plt.show()
