"""Label files: labelled ranges of takes, as people's annotation tools write and read them."""
