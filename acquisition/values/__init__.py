"""Lights, camera model and noise model: the values that a calibration estimates."""
