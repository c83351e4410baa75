"""Recordings: plans, sessions, image files, and the values of lights, camera and sensor."""

from acquisition._camera_model import CameraModel
from acquisition._errors import DataError, MissingPathError, StorageError
from acquisition._lights import Lights, light_id
from acquisition._noise_model import NoiseModel

__all__ = [
    "CameraModel",
    "DataError",
    "Lights",
    "MissingPathError",
    "NoiseModel",
    "StorageError",
    "light_id",
]
