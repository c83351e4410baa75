"""Shots: one LED, one exposure, one frame, and the proof that they belong together."""
