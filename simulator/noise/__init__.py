"""Random numbers that depend only on key and counter."""
