"""Kinds of samples, and standard deviations of normals."""
