"""Comparing methods of annotation: splits, the grid of methods by folds, and how good each is."""
