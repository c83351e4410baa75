"""Capture plans: their shots, duration and size in bytes."""
