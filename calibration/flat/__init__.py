"""Flat fields from matte cards under near lights."""
