"""Tests of kinedex, which run beside each other in as many processes as there are cores, or more."""

import os

# Threads of OpenMP wait for each other at full load: beside other tests, a small map takes six times its work.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")
