"""
Verify a session
================

`acquisition.verify_session` compares every file of a session with its hash. Use it after
copying, and before deleting an original; here one frame is damaged.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from acquisition import CapturePlan, Labels, record, verify_session
from simulator import open_rig_seeing, render, scene_named

view = render(scene_named("coin", width=160, height=128, leds=6))

plan = CapturePlan(leds="0-5", exposures_us=(20_000.0,))
folder = Path(tempfile.mkdtemp()) / "coin"
with open_rig_seeing(view, realtime=False, camera="inside") as rig:
    session = record(rig, plan, folder, Labels())
print(verify_session(folder).ok)

path = session.frames[3].path
content = bytearray(path.read_bytes())
content[5000:5100] = bytes(100)
path.write_bytes(content)
print(verify_session(folder).ok)

plt.figure(figsize=(8, 1.5), layout="constrained")
plt.bar(range(4900, 5200), content[4900:5200], width=1)
plt.xlabel(f"bytes of {path.name}")
plt.show()
