"""Reports: one HTML page with the maps of a result and the program that shows them."""
