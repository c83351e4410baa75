"""Normal maps from meshes and point clouds."""
