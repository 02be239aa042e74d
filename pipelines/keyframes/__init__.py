"""Learn keyframe queries in rounds of learning runs, which are spread over workers."""
