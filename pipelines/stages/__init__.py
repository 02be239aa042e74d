"""Stages of pipelines, one per module; a stage reads a store and commits its results, and imports no other stage."""
