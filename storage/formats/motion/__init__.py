"""Read motion files (Acclaim, BVH, C3D, AMASS, joint positions) as bodies, and write them from takes."""
