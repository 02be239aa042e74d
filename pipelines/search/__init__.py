"""Keyframe search in stores and in words."""
