"""Recompute the tables and figures of the paper for comparison with the published ones."""
