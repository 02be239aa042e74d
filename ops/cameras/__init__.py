"""Cameras as arrays: projection, lens distortion and the rays of pixels."""
