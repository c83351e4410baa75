"""Projection of meshes and point clouds to normal maps."""
