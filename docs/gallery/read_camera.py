"""
Read a camera
=============

`acquisition.read_camera` reads cameras of this program, OpenCV, COLMAP and AliceVision. Use it
where lengths matter: it turns pixels into rays and millimetres.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from acquisition import read_camera

path = Path(tempfile.mkdtemp()) / "camera.json"
path.write_text(
    """{"format": "sgp-camera", "version": 1, "width": 640, "height": 512,
    "K": [[1307.2, 0, 319.5], [0, 1307.2, 255.5], [0, 0, 1]], "distortion": [-0.1, 0, 0, 0, 0],
    "working_distance_mm": 600}"""
)
camera = read_camera(path)
print(camera)
points = camera.points_on_plane()  # (H, W, 3), mm
print(f"{points[255, 320, 0] - points[255, 319, 0]:.3f} mm per pixel")

plt.figure(figsize=(5, 4), layout="constrained")
plt.plot(*points[::64, ::64, :2].reshape(-1, 2).T, "+")
plt.axis("equal")
plt.xlabel("x in mm")
plt.ylabel("y in mm")
plt.title("pixels on the working plane")
plt.show()
