"""This package compares takes with inertial sensors, and simulates sensors (thesis, Chapter 7 and Appendix A)."""
