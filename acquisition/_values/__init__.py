"""Lights, camera model and noise model: the values that calibration estimates."""
