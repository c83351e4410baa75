"""Conversion of raw frames to linear radiance."""
