"""Keyframe queries: search them in stores and in words, explain and propose them, and learn them from clips."""
