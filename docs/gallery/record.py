"""
Record a session
================

`acquisition.record` takes every shot of a plan and writes it before it counts. Use it for
recordings that must survive whatever fails.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from acquisition import CapturePlan, Labels, read_image, record
from simulator import open_rig_seeing, render, scene_named

view = render(scene_named("coin", width=160, height=128, leds=6))

plan = CapturePlan(leds="0-5", exposures_us=(20_000.0,))
folder = Path(tempfile.mkdtemp()) / "coin"
with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    session = record(rig, plan, folder, Labels(object_name="coin", operator="me"))
print(f"{len(session.frames)} frames, complete: {session.complete}")

figure, axes = plt.subplots(2, 4, figsize=(9, 3.8), layout="constrained")
for axis, frame in zip(axes.flat, session.frames, strict=True):
    axis.imshow(read_image(frame.path), cmap="gray", vmin=0, vmax=3000)
    axis.set_title(frame.path.stem)
    axis.axis("off")
plt.show()
