"""What is checked before a capture."""
