"""Estimates of lights, camera and sensor, and raw frames turned into linear radiance."""

from calibration._errors import EstimateError

__all__ = ["EstimateError"]
