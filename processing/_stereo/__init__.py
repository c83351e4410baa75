"""Photometric stereo: frames under known lights to normals and albedo."""
