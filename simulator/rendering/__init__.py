"""The renderer and its ground truth."""
