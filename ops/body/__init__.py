"""This package computes with bodies: kinematics, filling of gaps, resampling, and features of joint positions."""
