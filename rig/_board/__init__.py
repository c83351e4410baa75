"""The LED board: its protocol, its line, its client."""
