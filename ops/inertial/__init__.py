"""Takes against inertial sensors, and sensors simulated from takes (thesis, Chapter 7 and Appendix A)."""
