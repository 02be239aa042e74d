"""This package records labels of people in stores, compares them with annotations, and imports label files."""
