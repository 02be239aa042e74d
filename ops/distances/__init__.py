"""Distance curves, and what is read off them: hits, labels, explanations."""
