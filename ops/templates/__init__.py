"""This package learns motion templates by warping and averaging, and mirrors, joins and compares them."""
