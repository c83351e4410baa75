"""The virtual LED board."""
