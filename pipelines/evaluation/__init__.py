"""Evaluation: compare annotations with ground truth, and compare annotation methods on splits and folds."""
