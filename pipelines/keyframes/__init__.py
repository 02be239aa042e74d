"""Keyframe queries that are learned, in rounds that any number of workers share."""
