"""Capture engine: runs a plan on a rig and records the session."""
