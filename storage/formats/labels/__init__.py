"""Label files: labelled stretches of takes, as people's annotation tools write and read them."""
