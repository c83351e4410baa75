"""Rig files, and the installed rigs."""
