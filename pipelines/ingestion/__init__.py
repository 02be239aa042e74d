"""Ingestion: find changes of a source, read motion files in batches, store takes, and read damaged takes again."""
