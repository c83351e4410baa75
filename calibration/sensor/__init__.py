"""Calibration of the sensor by photon transfer."""
