"""Geometry of spheres in images: ellipses, cones, mirror rays, and robust fits."""
