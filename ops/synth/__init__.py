"""This package generates the synthetic archive: an articulated body, motion classes, and actors who perform them."""
