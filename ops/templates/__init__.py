"""Motion templates: learned by warping and averaging, mirrored, joined, compared."""
