"""Maps larger than memory: files of rows, and what is done of them."""
