"""Sessions and sources written in the formats of other programs."""
