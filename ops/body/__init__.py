"""Bodies: from channels and positions to trajectories, features and words."""
