"""Highlights on spheres: where they are, and whether a ball mirrors."""
