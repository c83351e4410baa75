"""Stages of a run: what they read, compute, write and report."""
