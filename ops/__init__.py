"""The numbers: numpy in, numpy out; compiled kernels. No files but theirs, no SQL, no configuration, no logging."""

from pathlib import Path

from kinedex.ops.compiled import forget_outdated

forget_outdated(Path(__file__).parent, __name__)
