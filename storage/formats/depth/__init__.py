"""Files of depth recordings: cameras, images, clouds, and the file that names them."""
