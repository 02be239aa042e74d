"""Limbs of takes, inertial sensors worn on them, errors between the two, and simulated errors."""
