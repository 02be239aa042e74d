"""This package computes on bodies: kinematics, filling of gaps, resampling, and features of joint positions."""
