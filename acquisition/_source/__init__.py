"""Anything that holds frames and lights, read as one kind of source."""
