"""Read files of inertial sensors: accelerations, angular velocities, magnetic fields and orientations."""
