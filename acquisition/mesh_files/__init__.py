"""File formats of triangle meshes and point clouds."""
