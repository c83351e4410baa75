"""The bench: LED board, camera, and the two as one rig that knows which LED lit which frame."""
