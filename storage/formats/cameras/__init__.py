"""Files of camera recordings: calibrations, keypoints, masks, and the file that names them."""
