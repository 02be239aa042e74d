"""Write the synthetic archive as motion files."""
