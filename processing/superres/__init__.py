"""Super-resolution of normal maps."""
