"""This package learns motion templates by warping and averaging clips, and mirrors, joins and compares templates."""
