"""The synthetic archive as motion files."""
