"""The errors that the simulator raises. They are defined in the rooms it builds on."""

from acquisition import DataError, MissingPathError, StorageError
from rig import CameraError, RigConfigError, RigError

__all__ = [
    "CameraError",
    "DataError",
    "MissingPathError",
    "RigConfigError",
    "RigError",
    "StorageError",
]
