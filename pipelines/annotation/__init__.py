"""Annotation: label the frames of takes with classes by templates, and reuse annotations that are up to date."""
