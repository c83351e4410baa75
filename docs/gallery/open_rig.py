"""
Shots of a rig
==============

`rig.open_rig` opens a rig by its file or name; here the simulated one. Use it for your own
capture loop: each shot proves which LED was on.
"""

import matplotlib.pyplot as plt

from rig import open_rig

with open_rig("simulated") as rig:  # on a real bench: open_rig("bench.toml")
    shots = [rig.shoot(led, exposure_us=20_000) for led in (None, 0, 12, 24)]
dark, *lit = shots
for shot in lit:
    brighter = shot.frame.pixels.mean() - dark.frame.pixels.mean()
    print(f"LED {shot.led}: {brighter:.0f} DN brighter than without light")

figure, axes = plt.subplots(1, 4, figsize=(11, 2.6), layout="constrained")
for axis, shot in zip(axes, shots, strict=True):
    axis.imshow(shot.frame.pixels, cmap="gray", vmin=0, vmax=3000)
    axis.set_title("all off" if shot.led is None else f"LED {shot.led}")
    axis.axis("off")
plt.show()
