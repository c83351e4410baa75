"""What a rig requires of a camera, and how it is mounted."""
