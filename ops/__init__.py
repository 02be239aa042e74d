"""This package computes: its functions take and return numpy arrays, with compiled kernels underneath.

It reads and writes no files but the cache of compiled kernels, and has no SQL, configuration or logging.
"""

from pathlib import Path

from kinedex.ops.compiled import forget_outdated
from kinedex.ops.kernel_loader import load_kernels_alone

forget_outdated(Path(__file__).parent, __name__)
load_kernels_alone(__name__)
