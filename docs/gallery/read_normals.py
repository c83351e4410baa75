"""
Read a normal map
=================

`processing.read_normals` reads the normal maps of any program and finds out how they are
encoded. Use it for images of normals; notices say what is doubtful.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acquisition import write_png
from processing import NormalMap, read_normals
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

path = Path(tempfile.mkdtemp()) / "normals.png"
write_png(path, np.round((coin.normals + 1) * 127.5).astype(np.uint8))
found = read_normals(path)
for notice in found.warnings:
    print(notice)

plt.figure(figsize=(5, 3.6), layout="constrained")
plt.imshow(found.normal_map.normals[..., 0], cmap="gray")
plt.colorbar(label="x of the normals")
plt.axis("off")
plt.show()
