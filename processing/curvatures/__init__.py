"""Slopes and curvature of a surface from its normals."""
