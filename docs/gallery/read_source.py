"""
Open a recording
================

`acquisition.read_source` recognises a session, a DiLiGenT folder, an ``.lp`` file or a folder
of images. Use it first: it reads everything except the pixels, and every other step takes what
it returns.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acquisition import read_image, read_source, write_png
from simulator import render, scene_named

view = render(scene_named("coin", width=160, height=128, leds=12))
folder = Path(tempfile.mkdtemp())
for number, plane in enumerate(view.planes):
    frame = plane / view.planes.max() * 60_000
    write_png(folder / f"{number:02}.png", frame.astype(np.uint16))

source = read_source(folder, lights=view.truth.lights, camera=view.truth.camera)
print(source)
print(source.light_ids)

figure, axes = plt.subplots(1, 3, figsize=(9, 2.6), layout="constrained")
for axis, name in zip(axes, source.light_ids[::4], strict=True):
    axis.imshow(read_image(folder / f"{name}.png"), cmap="gray")
    axis.set_title(f"light {name}")
    axis.axis("off")
plt.show()
