"""Templates: learned from clips, made by recipes, checked, shown."""
