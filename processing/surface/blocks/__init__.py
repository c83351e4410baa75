"""Surfaces that are solved in blocks, see `processing.integrate_in_blocks`."""
