"""Skeletons: how the nodes or markers of a source become the named joints, and in which unit."""
