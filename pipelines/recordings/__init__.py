"""Recordings that become takes: what tracking by cameras and reconstruction from depth have in common."""
