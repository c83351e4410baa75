"""Whether images, lights and normals of a recording agree."""
