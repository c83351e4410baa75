"""
Write a normal map
==================

`processing.write_normals` writes normals as EXR and PNG, with their mask. Use ``green`` for
programs whose green points down, as in DirectX.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from processing import NormalMap, write_normals
from simulator import render, scene_named

truth = render(scene_named("coin", width=200, height=160, leds=4)).truth
coin = NormalMap(truth.normals, truth.mask)

folder = Path(tempfile.mkdtemp())
for name, path in write_normals(folder, coin).items():
    print(name, path.name)

plt.figure(figsize=(5, 4), layout="constrained")
plt.imshow(plt.imread(folder / "normals.png"))
plt.axis("off")
plt.show()
