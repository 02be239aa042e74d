"""This package computes on bodies: forward kinematics, gaps, resampling, and features from joint positions."""
