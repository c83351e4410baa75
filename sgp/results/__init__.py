"""Results on disk: record, figures, hashes, verification."""
