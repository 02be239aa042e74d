"""Recordings that become takes: the code shared by tracking with cameras and reconstruction from depth."""
