"""Read files of depth recordings: cameras, images, clouds, and the file that lists them."""
