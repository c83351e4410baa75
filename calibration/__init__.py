"""Estimates of lights, camera and sensor, and raw frames turned into linear radiance."""

from calibration._conic import Ellipse
from calibration._errors import EstimateError
from calibration._find_spheres import SphereImage, find_spheres
from calibration._intensities import IntensityCalibration, calibrate_intensities
from calibration._radiance import Stack, linear_stack
from calibration._spheres import Sphere, SphereCalibration, calibrate_spheres

__all__ = [
    "Ellipse",
    "EstimateError",
    "IntensityCalibration",
    "Sphere",
    "SphereCalibration",
    "SphereImage",
    "Stack",
    "calibrate_intensities",
    "calibrate_spheres",
    "find_spheres",
    "linear_stack",
]
