"""Shape and detail of normal maps: separated, measured, transferred."""
