"""Intensities, axes and radiation patterns of near lights from matte surfaces."""
