"""Imperfect recordings: what one imperfection does to a result, and what the program says."""
