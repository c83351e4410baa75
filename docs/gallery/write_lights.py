"""
Write lights
============

`acquisition.write_lights` writes lights with their errors as JSON, or their directions as
``.lp``. Use it to keep a calibration, or to give lights to another program.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from acquisition import write_lights
from simulator import dome_lights

lights = dome_lights(16)
folder = Path(tempfile.mkdtemp())
write_lights(folder / "lights.json", lights)
write_lights(folder / "lights.lp", lights)
print((folder / "lights.lp").read_text()[:120])

axis = plt.figure(figsize=(5, 4), layout="constrained").add_subplot(projection="3d")
axis.scatter(*lights.positions_mm.T)
axis.scatter(0, 0, 0, marker="s")
axis.set_xlabel("x in mm")
axis.set_ylabel("y in mm")
plt.show()
