"""Annotation of takes, what of it still holds, and its labels in other formats."""
