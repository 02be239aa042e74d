"""The work of each guarded figure, and drivers that say how a commit does it."""
