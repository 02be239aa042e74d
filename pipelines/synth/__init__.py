"""The synthetic archive as files."""
