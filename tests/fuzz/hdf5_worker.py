"""A process that reads many HDF5 files, one after the other, for the fuzzer.

The reader of kinedex begins a process for each file, which the fuzzer has no time for. Here the same program serves one
file after the other; where the HDF5 library crashes or hangs on one, that file is refused, as by the reader, and a new
process begins.
"""

from __future__ import annotations

import io
import json
import os
import select
import subprocess
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from unittest.mock import patch

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu import hdf5

PATIENCE_S = 20.0
_HEADER = 9
_READ, _REFUSED = b"0", b"1"


class Worker:
    """A process that is asked for files, begun anew after a crash."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.crashes = 0

    def run(self, path: Path, names: tuple[str, ...]) -> bytes:
        """Answer as `hdf5._run` does."""
        if self.process is None or self.process.poll() is not None:
            self.process = subprocess.Popen(
                [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, env=os.environ | {"HDF5_PLUGIN_PRELOAD": "::", "OMP_NUM_THREADS": "1"},
            )  # fmt: skip
        process = self.process
        assert process.stdin is not None
        try:
            process.stdin.write(json.dumps([str(path), list(names)]).encode() + b"\n")
            process.stdin.flush()
            header = self._bytes(process, _HEADER)
            answer = self._bytes(process, int.from_bytes(header[1:], "little"))
        except (OSError, EOFError):
            self.crashes += 1
            self.close()
            raise SourceError(path, "is damaged: the HDF5 library ends on it") from None
        if header[:1] == _REFUSED:
            raise SourceError(path, f"is damaged: {answer.decode('utf-8', 'replace')}")
        return answer

    def _bytes(self, process: subprocess.Popen[bytes], count: int) -> bytes:
        assert process.stdout is not None
        found, pipe = b"", process.stdout.fileno()
        while len(found) < count:
            ready, _, _ = select.select([pipe], [], [], PATIENCE_S)
            part = os.read(pipe, count - len(found)) if ready else b""
            if not part:
                raise EOFError
            found += part
        return found

    def close(self) -> None:
        """End the process."""
        if self.process is not None:
            self.process.kill()
            self.process.wait(timeout=240)
            for pipe in (self.process.stdin, self.process.stdout):
                if pipe is not None:
                    pipe.close()
            self.process = None


_workers: dict[int, Worker] = {}


def shared_worker() -> Worker:
    """Return the worker of this process; it ends with it, for its input ends then."""
    return _workers.setdefault(os.getpid(), Worker())


def by_worker() -> AbstractContextManager[object]:
    """Return a context in which HDF5 files are read by the worker."""
    return patch.object(hdf5, "_run", shared_worker().run)


def serve() -> None:
    """Read the files that are asked for until the input ends."""
    import numpy as np

    from kinedex.storage.formats.imu import hdf5_child

    for line in sys.stdin.buffer:
        path, names = json.loads(line)
        try:
            if names:
                packed = io.BytesIO()
                np.savez(packed, **hdf5_child.read(path, names))
                answer = _READ, packed.getvalue()
            else:
                answer = _READ, json.dumps(hdf5_child.describe(path)).encode()
        except Exception as fault:  # as in the program itself
            answer = _REFUSED, (str(fault).splitlines()[0][:300] if str(fault) else type(fault).__name__).encode()
        sys.stdout.buffer.write(answer[0] + len(answer[1]).to_bytes(8, "little") + answer[1])
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    serve()
