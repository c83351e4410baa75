"""File formats of lights and cameras."""
