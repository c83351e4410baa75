"""Export of sessions to the formats of other programs."""
