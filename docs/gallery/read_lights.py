"""
Read lights
===========

`acquisition.read_lights` reads the lights of this and of other programs. Use it to see where
lights are before you trust a result.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from acquisition import read_lights

path = Path(tempfile.mkdtemp()) / "dome.lp"
path.write_text("4\na.jpg 0.5 0 0.87\nb.jpg 0 0.6 0.8\nc.jpg -0.7 0 0.71\nd.jpg 0 -0.3 0.95\n")
lights = read_lights(path)
print(lights)

plt.figure(figsize=(4, 4), layout="constrained")
plt.gca().add_patch(plt.Circle((0, 0), 1, fill=False))
plt.plot(*lights.unit_directions[:, :2].T, "o")
for name, (x, y, _) in zip(lights.ids, lights.unit_directions, strict=True):
    plt.annotate(name, (x, y), xytext=(5, 5), textcoords="offset points")
plt.axis("equal")
plt.title("directions, seen from above")
plt.show()
