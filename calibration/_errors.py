"""The errors that calibration raises."""

from acquisition import DataError

__all__ = ["DataError", "EstimateError"]


class EstimateError(ValueError):
    """Valid input does not determine the estimate; the message says why (exit code 5)."""
