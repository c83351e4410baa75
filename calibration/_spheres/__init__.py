"""Lights from their highlights on mirror spheres."""
