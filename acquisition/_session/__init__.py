"""Sessions on disk: written, read, verified, compacted."""
