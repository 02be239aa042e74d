"""Evaluate takes against inertial sensors worn on the limbs: calibration, limb errors, and simulated errors."""
