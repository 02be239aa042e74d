"""Motion files: Acclaim, BVH, C3D, AMASS and joint positions, read as bodies and written from takes."""
