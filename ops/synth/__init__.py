"""The synthetic archive: an articulated body, the motions it knows, and the actors who perform them."""
