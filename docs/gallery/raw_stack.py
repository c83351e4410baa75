"""
Linear images of a recording
============================

`calibration.raw_stack` gives one linear image per light; 1 is the white level. Use it, or
`calibration.linear_stack`, when you write an estimator of your own.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from acquisition import read_source, write_png
from calibration import raw_stack
from simulator import render, scene_named

view = render(scene_named("coin", width=160, height=128, leds=12))
folder = Path(tempfile.mkdtemp())
for number, plane in enumerate(view.planes):
    frame = plane / view.planes.max() * 60_000
    write_png(folder / f"{number:02}.png", frame.astype(np.uint16))

stack = raw_stack(read_source(folder, lights=view.truth.lights))
print(stack)
pixel = stack.values[:, 64:65, 80:81].ravel()  # one pixel under all lights

plt.figure(figsize=(6, 3), layout="constrained")
plt.bar(range(len(pixel)), pixel)
plt.xlabel("light")
plt.ylabel("value of the pixel")
plt.show()
