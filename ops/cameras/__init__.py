"""This package computes with cameras as arrays: projection, lens distortion and the rays of pixels."""
