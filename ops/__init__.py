"""The numbers: numpy in, numpy out; compiled kernels. No files but theirs, no SQL, no configuration, no logging."""

from pathlib import Path

from kinedex.ops.compiled import forget_outdated
from kinedex.ops.kernel_loader import load_kernels_alone

forget_outdated(Path(__file__).parent, __name__)
load_kernels_alone(__name__)
