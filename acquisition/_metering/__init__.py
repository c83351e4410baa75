"""Exposures chosen by what the camera sees."""
