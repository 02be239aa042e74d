"""Files that come in: what changed, batches, reading, failures."""
