"""Repair a store: restore damaged files or move them to quarantine; pipelines re-read sources and re-run stages."""
