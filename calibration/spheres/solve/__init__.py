"""Positions of spheres, and directions and positions of the lights that they show."""
