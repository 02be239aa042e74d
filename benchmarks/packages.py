"""Other readers of motion files: packages of the `bench` group that do the same work."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterable
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Figure, seconds

Readers = dict[str, Callable[[Any], object]]


def of_bvh(path: Path) -> Readers:
    """Packages that read a whole BVH file, numbers included."""
    return {
        "bvhsdk": lambda package: package.ReadFile(str(path)),
        "bvhio": lambda package: package.readAsBvh(str(path)),
        "bvh": lambda package: np.array(package.Bvh(path.read_text()).frames, dtype=float),
    }


def of_acclaim(asf: Path, amc: Path) -> Readers:
    """Packages that read an ASF file and an AMC file that belongs to it."""
    return {"pyacclaim": lambda package: package.loadAMC(package.loadASF(str(asf), verbose=False), str(amc))}


def of_c3d(path: Path) -> Readers:
    """Packages that read a C3D file."""
    return {"ezc3d": lambda package: package.c3d(str(path))["data"]["points"]}


def beside(name: str, path: Path, ours: Callable[[], object], readers: Readers) -> Iterable[Figure]:
    """Time our reader of a file and those of other packages in the same run.

    Parameters
    ----------
    name : str
        The name of the figures.
    path : Path
        The file.
    ours : callable
        Reads the file.
    readers : dict
        Package name → its function that reads the file.
    """
    megabytes = path.stat().st_size / 1e6
    time = seconds(ours)
    for package, read in readers.items():
        try:
            module = import_module(package)
        except ImportError:
            yield Figure(name, megabytes, "MB", time, f"{package}: not installed (make bench installs it)")
            continue
        with contextlib.redirect_stdout(io.StringIO()):  # some packages print while they read
            other = seconds(lambda module=module, read=read: read(module), 1)
        yield Figure(name, megabytes, "MB", time, f"{package} {metadata.version(package)}", other)
