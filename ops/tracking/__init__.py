"""This package fits the poses of a kinematic chain to camera observations (thesis, Section 6.2)."""
