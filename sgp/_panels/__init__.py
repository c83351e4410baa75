"""Panels of sheets: results as pictures."""
