"""Ingestion of motion files: find changes of a source, read files in batches, store takes, and record failures."""
