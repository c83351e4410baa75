"""Surfaces and solids, and where rays meet them."""
