"""Normals and albedo from images in colour."""
