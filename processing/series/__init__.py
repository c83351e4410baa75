"""What all images of a series share, fitted with normals and albedo."""
