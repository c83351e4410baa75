"""Surfaces that are solved in blocks, see `processing.surface.integrate_in_blocks`."""
