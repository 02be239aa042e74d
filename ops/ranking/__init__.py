"""This package finds the best matches of a template in an archive exactly, without computing all distances."""
