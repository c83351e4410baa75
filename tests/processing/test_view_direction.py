"""`best` in a perspective view: the highlights depend on where the camera is."""

import numpy as np

from acquisition import CameraModel, Lights, angle_deg
from processing import photometric_stereo
from simulator.scene import Ggx
from simulator.scene.reflectance import reflectance


def test_a_glossy_plane_at_30_degrees_off_axis():
    size, focal = 24, 400.0
    # The optical axis meets the plane far to the left of the image.
    K = [[focal, 0, size / 2 - focal * np.tan(np.radians(30))], [0, focal, size / 2], [0, 0, 1]]
    camera = CameraModel(np.array(K), size, size, working_distance_mm=600.0)
    rays = camera.pixel_rays()
    toward = -rays / np.linalg.norm(rays, axis=2, keepdims=True)
    assert 27 < angle_deg(toward, np.broadcast_to([0.0, 0.0, 1.0], toward.shape)).mean() < 33
    z = np.linspace(0.97, 0.35, 40)
    turn = np.arange(40) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], (size, size, 3))
    gloss = reflectance(Ggx(0.3, 0.04), 0.1, normals, directions[:, None, None], toward)
    values = np.clip(directions[:, 2], 0, None)[:, None, None] * gloss
    mask = np.ones((size, size), bool)
    known, distant = (
        angle_deg(
            photometric_stereo(
                values, Lights(directions), mask, method="best", camera=given
            ).normal_map.normals,
            normals,
        ).mean()
        for given in (camera, None)
    )
    assert known < 0.5 * distant
