"""Integration of normals to surfaces."""
