"""Readers for all kinds of recordings, which return the same kind of source."""
