"""A source to normals and height in one call."""
