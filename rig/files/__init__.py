"""Files that are read: their guard, and their status."""
