"""Export data sets from a store as files: choose clips, write them in a format, and record their origin."""
