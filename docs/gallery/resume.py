"""
Resume a recording
==================

`acquisition.resume` takes the shots that a session lacks, and no others. Use it after any
interruption; here two frames are lost and taken again.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from acquisition import CapturePlan, Labels, record, resume
from simulator import open_rig_seeing, render, scene_named

view = render(scene_named("coin", width=160, height=128, leds=6))

plan = CapturePlan(leds="0-5", exposures_us=(20_000.0,))
folder = Path(tempfile.mkdtemp()) / "coin"
with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    session = record(rig, plan, folder, Labels())
    for frame in session.frames[2:4]:
        frame.path.unlink()
    session = resume(rig, folder, retake_damaged=True)
print(f"complete: {session.complete}, set aside: {len(session.set_aside)}")

names = [frame.path.stem for frame in session.recorded]
plt.figure(figsize=(7, 2.5), layout="constrained")
plt.scatter(range(len(names)), names)
plt.xlabel("order of recording")
plt.show()
