"""Synthesis of detail components from exemplars, and its quality figures."""
