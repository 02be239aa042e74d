"""This package simulates recordings of motion: cameras, keypoint detections and their failures, and depth images."""
