"""Simulate recordings of takes, by cameras, depth cameras and inertial sensors, and make the synthetic archive."""
