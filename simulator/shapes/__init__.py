"""Surfaces and solids, and ray hits on them."""
