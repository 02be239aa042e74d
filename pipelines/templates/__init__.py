"""This package learns motion templates from examples, reads and combines them, and ranks archives by them."""
