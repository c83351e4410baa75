"""Maps larger than memory: files of rows that fill band by band."""
