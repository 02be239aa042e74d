"""Limbs of takes, sensors worn on them, and sensors that are simulated."""
