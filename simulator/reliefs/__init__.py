"""Random reliefs of many kinds, on which networks are trained and judged."""
