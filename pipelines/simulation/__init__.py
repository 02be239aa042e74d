"""Simulated recordings of takes of a store."""
