"""Read and write the file formats of motion, labels, cameras, depth frames and inertial sensors."""
