"""This package finds the intervals of an archive that fit a template best, exactly, without computing all distances."""
