"""What can go wrong with an estimate."""


class EstimateError(Exception):
    """Sound input does not determine the estimate; the message says why (exit code 5)."""
