"""Cuts along which overlapping parts of a map differ least."""
