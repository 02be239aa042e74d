"""This package searches keyframes: runs, inverted lists, bit slices, and ranges around hits for templates."""
