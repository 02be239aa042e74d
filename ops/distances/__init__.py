"""This package computes distance curves of templates, and bounds, paths and minima of these curves."""
