"""What the commands that calibrate share: boards, their views, marks of spheres."""
