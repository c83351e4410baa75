"""
From images to normals
======================

`processing.reconstruct` computes normals, albedo and height of a recording, and judges them.
Use it for what ``sgp run`` does, without files.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acquisition import read_source, write_png
from processing import reconstruct
from simulator import render, scene_named

view = render(scene_named("coin", width=160, height=128, leds=12))
folder = Path(tempfile.mkdtemp())
for number, plane in enumerate(view.planes):
    frame = plane / view.planes.max() * 60_000
    write_png(folder / f"{number:02}.png", frame.astype(np.uint16))

lights, camera = view.truth.lights, view.truth.camera
result = reconstruct(read_source(folder, lights=lights, camera=camera), surface=False)
print(result.verdict.answer)
for warning in result.warnings:
    print(warning)

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
left.imshow((result.normals.normals + 1) / 2)
left.set_title("normals")
right.imshow(result.maps["albedo"], cmap="gray")
right.set_title("albedo")
for axis in (left, right):
    axis.axis("off")
plt.show()
