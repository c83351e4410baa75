"""What the user configured, and the lights of rig files."""
