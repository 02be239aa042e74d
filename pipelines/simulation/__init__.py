"""Simulate recordings of takes of a store, by cameras, depth cameras and inertial sensors."""
