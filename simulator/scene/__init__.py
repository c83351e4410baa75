"""Scenes: bodies, materials, lamps and lens."""
