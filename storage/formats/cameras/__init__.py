"""Read files of camera recordings: calibrations, keypoints, masks, and the file that lists them."""
