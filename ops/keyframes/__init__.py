"""Keyframe queries that are learned: fitness, evolution, consensus."""
