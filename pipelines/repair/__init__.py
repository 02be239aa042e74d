"""Repair of stores: takes are read again from their sources, results come back by runs of their pipelines."""
