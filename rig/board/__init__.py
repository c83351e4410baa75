"""The LED board: protocol, serial line and client."""
