"""Holes in normal maps, filled from what surrounds them."""
