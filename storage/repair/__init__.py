"""Repair of a store: what is damaged is made again or kept aside; the pipelines read sources and run stages for it."""
