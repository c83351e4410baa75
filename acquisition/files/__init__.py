"""Files: durable writes, temporary and staged files, bands of rows, texts, JSON and TOML."""
