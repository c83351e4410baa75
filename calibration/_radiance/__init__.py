"""Raw frames turned into linear radiance."""
