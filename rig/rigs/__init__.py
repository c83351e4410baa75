"""LED board and camera as one rig, and how it is opened."""
