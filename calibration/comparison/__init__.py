"""Comparison of two calibrations of the same lights."""
