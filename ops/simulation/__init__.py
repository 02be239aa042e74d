"""Simulated recordings of motion: cameras around a scene, keypoints of a detector, and its failures."""
