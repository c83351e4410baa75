"""Whether given values, images and recordings agree with the spheres."""
