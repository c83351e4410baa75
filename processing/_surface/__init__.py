"""Surfaces from normals."""
