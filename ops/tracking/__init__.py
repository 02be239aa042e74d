"""The pose of a kinematic chain from what cameras see (thesis, Section 6.2)."""
