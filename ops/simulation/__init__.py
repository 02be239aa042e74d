"""This package simulates recordings of motion by cameras with keypoint detectors, and by depth cameras."""
