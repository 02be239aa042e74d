"""This package compares annotations with ground truth, and annotation methods with each other on splits and folds."""
