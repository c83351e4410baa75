"""Calibration of lights from their highlights on mirror spheres."""
