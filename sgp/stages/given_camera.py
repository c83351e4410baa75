"""Whether a camera can belong to an image, where its file does not state the size of its own."""

from __future__ import annotations

from pathlib import Path

import acquisition
import rig

# Lenses are centred within a few percent of the image. Of a camera for an image of twice the size,
# the principal point is half of a side away from the middle; for half the size, a quarter.
_MOST_SHIFT = 0.2
# A wider view, 120 degrees, has no pinhole camera.
_LEAST_FOCAL = 0.29


def camera_notices(path: Path, camera: acquisition.CameraModel) -> list[rig.Notice]:
    """Return notices if the camera may be that of an image of another size, or of a crop."""
    size = camera.width, camera.height
    middle = camera.K[:2, 2]
    shift = max(abs(middle[i] - (size[i] - 1) / 2) / size[i] for i in (0, 1))
    image = f"an image of {size[0]} x {size[1]} pixels"
    texts = []
    if shift > _MOST_SHIFT:
        texts.append(
            f"the principal point ({middle[0]:.0f}, {middle[1]:.0f}) is far from the middle of "
            f"{image}: unless the image is a crop, the camera belongs to another size"
        )
    if camera.focal_px < _LEAST_FOCAL * max(size):
        texts.append(
            f"a focal length of {camera.focal_px:.4g} pixels is too short for {image}: the camera "
            "may belong to another size, or state the focal length in mm"
        )
    return [rig.Notice("camera-doubtful", text, str(path)) for text in texts]
