"""Motion templates: learn them from examples, read and combine them, and rank archives by them."""
