"""Faults that once passed all tests, with the text that they change."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Planted:
    """A fault to plant: ``old``, which is in the file exactly once, is replaced by ``new``."""

    name: str
    file: str
    old: str
    new: str


PLANTED = (
    Planted(
        "a dark frame before an ambient one",
        "acquisition/engine/rejection.py",
        'ambient = self._dark.get(("ambient", shot.exposure_us))\n'
        '        return ambient or self._dark.get(("dark", shot.exposure_us))',
        'dark = self._dark.get(("dark", shot.exposure_us))\n'
        '        return dark or self._dark.get(("ambient", shot.exposure_us))',
    ),
    Planted(
        "the last frame without light counts",
        "acquisition/engine/rejection.py",
        "self._dark[shot.role, shot.exposure_us] = quality",
        'self._dark["ambient", shot.exposure_us] = quality',
    ),
    Planted(
        "the shortest exposure gives the light of an LED",
        "acquisition/engine/rejection.py",
        "light.exposure_us > known.exposure_us",
        "light.exposure_us < known.exposure_us",
    ),
    Planted(
        "the last repeat gives the light of an LED",
        "acquisition/engine/rejection.py",
        "light.exposure_us > known.exposure_us",
        "light.exposure_us >= known.exposure_us",
    ),
    Planted(
        "LED on too short for a fast clock",
        "rig/shooting/shot_times.py",
        "self.needed_us * (1 + CLOCK_SHARE) + self.margin_us",
        "self.needed_us * (1 - CLOCK_SHARE) + self.margin_us",
    ),
    Planted(
        "the clock's share is ignored",
        "rig/shooting/shot_times.py",
        "self.needed_us * (1 + CLOCK_SHARE) + self.margin_us",
        "self.needed_us + self.margin_us",
    ),
    Planted(
        "edges weigh c^2, orthographic",
        "processing/surface/chord_rule.py",
        "right[r + 1, c + 1] = cosine2 * cosine2\n"
        "                    step_right[r + 1, c + 1] = -x / z",
        "right[r + 1, c + 1] = cosine2\n                    step_right[r + 1, c + 1] = -x / z",
    ),
    Planted(
        "edges weigh c^2, in perspective",
        "processing/surface/chord_rule.py",
        "down[r + 1, c + 1] = cosine2 * cosine2\n"
        "                    step_down[r + 1, c + 1] = math.log(near / far)",
        "down[r + 1, c + 1] = cosine2\n"
        "                    step_down[r + 1, c + 1] = math.log(near / far)",
    ),
    Planted(
        "a low pass of twice the width",
        "processing/detail/local_transfer.py",
        "sigma_px = 0.5 * math.sqrt(1 / self.scale**2 - 1)",
        "sigma_px = math.sqrt(1 / self.scale**2 - 1)",
    ),
    Planted(
        "a low pass that ignores the pixel's own width",
        "processing/detail/local_transfer.py",
        "sigma_px = 0.5 * math.sqrt(1 / self.scale**2 - 1)",
        "sigma_px = 0.5 * math.sqrt(1 / self.scale**2)",
    ),
    Planted(
        "the covariance of the cone without its second term",
        "calibration/spheres/geometry/cone.py",
        "slope = np.eye(3) / root - np.outer(v, v) / root**3",
        "slope = np.eye(3) / root",
    ),
    Planted(
        "the covariance of the cone with a wrong sign",
        "calibration/spheres/geometry/cone.py",
        "slope = np.eye(3) / root - np.outer(v, v) / root**3",
        "slope = np.eye(3) / root + np.outer(v, v) / root**3",
    ),
    Planted(
        "spheres below the plane are not reported",
        "calibration/spheres/solve/sphere_positions.py",
        "if abs(beneath_mm) <= _FARTHEST_SHARE",
        "if beneath_mm <= _FARTHEST_SHARE",
    ),
    Planted(
        "a cap behind the origin of a ray is hit",
        "simulator/shapes/surface.py",
        "hit = (root >= 0) & (t > 0) & (points[..., 2] >= 0)",
        "hit = (root >= 0) & (points[..., 2] >= 0)",
    ),
)
