"""Read HDF5 files: check size and header, then open them in a child process, which a damaged file may crash."""

from __future__ import annotations

import importlib.util
import io
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import KinedexError, SourceError

SIGNATURE = b"\x89HDF\r\n\x1a\n"
"""The first bytes of an HDF5 file."""

MOST_BYTES = 4 << 30
"""The largest memory of data sets that are read together, in bytes."""

_PROGRAM = "kinedex.storage.formats.imu.hdf5_child:main"
_CHILD = Path(__file__).with_name(_PROGRAM.partition(":")[0].rpartition(".")[2] + ".py")
_PLACES = {0: (13, 14, 24), 1: (13, 14, 28), 2: (9, 10, 12), 3: (9, 10, 12)}
_PATIENCE_S = 60
_BYTES_A_SECOND = 4 << 20


@dataclass(frozen=True)
class Dataset:
    """A data set, or a field of a compound one.

    Attributes
    ----------
    shape : tuple of int
        Its shape.
    kind : str
        The kind of its type, as in NumPy: f, i, u, b, S, O, …
    """

    shape: tuple[int, ...]
    kind: str


@dataclass(frozen=True)
class Hdf5Contents:
    """The data sets and attributes of a file.

    Attributes
    ----------
    datasets : dict of str to Dataset
        Path → data set; a field of a compound one is `path/field`.
    attributes : dict of str to dict
        Path of a group or data set, "" for the file → its short texts, lists of texts, and single numbers.
    """

    datasets: dict[str, Dataset]
    attributes: dict[str, dict[str, Any]]


def hdf5_contents(path: Path) -> Hdf5Contents:
    """Return the data sets and attributes of an HDF5 file, without the values of the data sets.

    Raises
    ------
    SourceError
        The file is damaged.
    KinedexError
        The package h5py is not installed.
    """
    check_header(path)
    try:
        listing = json.loads(_run(path, ()))
    except ValueError:
        raise SourceError(path, "is damaged: the names of its data sets cannot be read") from None
    datasets = {}
    for name, item in listing["datasets"].items():
        shape = tuple(int(size) for size in item["shape"])
        for field, kind in zip(item["fields"] or [""], item["kinds"], strict=True):
            datasets[f"{name}/{field}" if field else name] = Dataset(shape, kind)
    return Hdf5Contents(datasets, listing["attributes"])


def hdf5_arrays(path: Path, contents: Hdf5Contents, names: Sequence[str]) -> list[npt.NDArray[Any]]:
    """Return data sets of a file, numbers as float64 and integers as int64.

    Raises
    ------
    SourceError
        A data set holds no numbers, the file is damaged, or the data sets are too large.
    """
    size = 0
    for name in names:
        dataset = contents.datasets[name]
        if dataset.kind not in "fiub":
            raise SourceError(path, f"data set '{name}' must hold numbers")
        size += 8 * prod(dataset.shape)
    if size > MOST_BYTES:
        raise SourceError(path, f"has {size / 1e9:.1f} GB in its data sets, and {MOST_BYTES / 1e9:.1f} GB are read")
    try:
        with np.load(io.BytesIO(_run(path, tuple(names))), allow_pickle=False) as packed:
            found = [packed[str(i)] for i in range(len(names))]
    except (ValueError, OSError, KeyError, EOFError) as fault:
        raise SourceError(path, f"is damaged: {fault}") from None
    for name, values in zip(names, found, strict=True):
        if values.shape != contents.datasets[name].shape:
            raise SourceError(path, f"is damaged: data set '{name}' has the shape {values.shape}")
    return found


def check_header(path: Path) -> None:
    """Check the first bytes of an HDF5 file, and that it has the size that they state.

    Raises
    ------
    SourceError
        The file is not HDF5, or is truncated.
    """
    try:
        with path.open("rb") as file:
            head = file.read(96)
            size = path.stat().st_size
    except OSError as fault:
        raise SourceError(path, f"cannot be read: {fault.strerror}") from fault
    if not head.startswith(SIGNATURE):
        raise SourceError(path, "is no HDF5 file")
    version = head[8] if len(head) > 8 else -1
    if version not in _PLACES or len(head) < 60:
        raise SourceError(path, f"has a header that is damaged, of the version {version}; 0 to 3 are known")
    offsets, lengths, base = _PLACES[version]
    if head[offsets] != 8 or head[lengths] != 8:
        raise SourceError(path, "has a header that is damaged: places and sizes must have 8 bytes")
    start = int.from_bytes(head[base : base + 8], "little")
    end = int.from_bytes(head[base + 16 : base + 24], "little")
    if start != 0 or end > size:
        raise SourceError(path, f"is cut off: its header states {end:,} bytes, and it has {size:,}")


def _run(path: Path, names: tuple[str, ...]) -> bytes:
    """Return the output of the child process; raise SourceError if it failed, crashed or ran too long."""
    if importlib.util.find_spec("h5py") is None:
        raise KinedexError(f"{path}: HDF5 files are read by h5py, which is not installed: pip install 'kinedex[imu]'")
    patience = _PATIENCE_S + path.stat().st_size / _BYTES_A_SECOND
    # plugins that a file asks for are not loaded
    command = [sys.executable, "-P", str(_CHILD), str(path.resolve()), *names]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=patience, stdin=subprocess.DEVNULL, check=False,
            env=os.environ | {"HDF5_PLUGIN_PRELOAD": "::", "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise SourceError(path, f"is damaged: it was not read in {patience:.0f} s") from None
    except (OSError, ValueError) as fault:
        raise SourceError(path, f"cannot be read: {fault}") from None
    if done.returncode:
        lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
        reason = lines[-1] if done.returncode == 1 and lines else "the HDF5 library ends on it"
        raise SourceError(path, f"is damaged: {reason}")
    return done.stdout
