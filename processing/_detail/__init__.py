"""Separation, measurement and transfer of the shape and detail of normal maps."""
