"""Repair stores: read takes again from their sources, and make results again by running their pipelines."""
