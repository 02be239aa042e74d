"""This package holds all computations, as functions of numpy arrays that call compiled kernels.

The only files that it reads and writes are those of the cache of compiled kernels. It uses no SQL, configuration or
logging.
"""

from pathlib import Path

from kinedex.ops.kernel_loader import load_kernels_alone
from kinedex.ops.outdated_kernels import forget_outdated

forget_outdated(Path(__file__).parent, __name__)
load_kernels_alone(__name__)
