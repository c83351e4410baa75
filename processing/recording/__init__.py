"""Reconstruction of normals and height from a source in one call."""
