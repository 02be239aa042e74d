"""Bodies: kinematics from channels to positions, gaps, resampling, and features from positions."""
