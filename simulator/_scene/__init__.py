"""Scenes: bodies, materials, lamps and a lens."""
