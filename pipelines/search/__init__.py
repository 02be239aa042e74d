"""Search keyframe queries in stores and in words in memory."""
