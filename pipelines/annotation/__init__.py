"""This package labels the frames of takes with classes by templates, and reuses annotations that are up to date."""
