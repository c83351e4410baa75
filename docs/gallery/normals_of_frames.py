"""
Normals in a running line
=========================

`processing.normals_of_frames` reads the frames of a camera in place and writes into maps that
exist. Use it where each part must be inspected within milliseconds.
"""

import matplotlib.pyplot as plt
import numpy as np

from acquisition import Lights
from processing import StereoMaps, normals_of_frames
from simulator import render, scene_named

view = render(scene_named("step-gauge", width=320, height=256, leds=8))
lights = Lights(directions=view.truth.lights.positions_mm)
buffer = (view.planes / view.planes.max() * 4000).astype(np.uint16)  # the camera's frames
maps = StereoMaps.empty((128, 160))  # once
for _ in range(3):  # for each part
    normals_of_frames(buffer, lights, saturation=4095, region=(80, 64, 160, 128), out=maps)
tilt_deg = np.degrees(np.arctan2(np.hypot(*maps.normals[..., :2].T), maps.normals[..., 2].T)).T
print(f"{np.mean(tilt_deg > 20):.1%} of the pixels are tilted by more than 20 degrees")

plt.figure(figsize=(5, 3.6), layout="constrained")
plt.imshow(tilt_deg, cmap="magma")
plt.colorbar(label="tilt in degrees")
plt.axis("off")
plt.show()
