"""The renderer and the truth it leaves."""
