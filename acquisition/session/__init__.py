"""Sessions: writing, reading, verification and compaction."""
