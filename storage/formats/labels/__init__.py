"""Read and write label files: labelled intervals of takes, in the formats of annotation tools."""
