"""Ingestion of motion files: changes of a source, batches, reading, and failures."""
