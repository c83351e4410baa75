"""Errors of estimates."""


class EstimateError(Exception):
    """Valid input does not determine the estimate; the message says why (exit code 5)."""
