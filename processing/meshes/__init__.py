"""Triangle meshes of surfaces and their files."""
