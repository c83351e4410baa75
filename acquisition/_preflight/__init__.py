"""Checks before a capture."""
