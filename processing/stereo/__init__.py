"""Photometric stereo: normals and albedo from images under known lights."""
