"""This package computes: its functions take and return numpy arrays, with compiled kernels underneath.

It reads and writes no files but the cache of compiled kernels, and has no SQL, configuration or logging.
"""

from pathlib import Path

from kinedex.ops.kernel_loader import load_kernels_alone
from kinedex.ops.outdated_kernels import forget_outdated

forget_outdated(Path(__file__).parent, __name__)
load_kernels_alone(__name__)
