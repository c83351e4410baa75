"""The errors that processing raises. They are defined in the rooms it builds on."""

from acquisition import DataError, MissingPathError, StorageError
from calibration import EstimateError

__all__ = ["DataError", "EstimateError", "MissingPathError", "StorageError"]
