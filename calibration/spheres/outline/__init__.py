"""Outlines of spheres, from edges, masks and what the spheres mirror."""
