"""From linear images to normals, shape, detail and geometry."""
