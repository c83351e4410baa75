"""The virtual cameras and their sensor."""
