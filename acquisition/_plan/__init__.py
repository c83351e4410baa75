"""Capture plans: what is shot, how long it takes, how many bytes it makes."""
