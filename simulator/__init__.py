"""A rig made of numbers: scenes, renderer, sensor, virtual LED board and virtual camera."""
