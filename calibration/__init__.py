"""Estimates of lights, camera and sensor, and raw frames turned into linear radiance."""

from calibration._errors import EstimateError
from calibration._intensities import IntensityCalibration, calibrate_intensities
from calibration._radiance.linear_stack import Stack, linear_stack
from calibration._spheres.calibrate import calibrate_spheres
from calibration._spheres.ellipse import Ellipse
from calibration._spheres.find import find_spheres
from calibration._spheres.sphere_calibration import Sphere, SphereCalibration
from calibration._spheres.sphere_image import SphereImage

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
