"""Read arrays of NPY and NPZ files safely: no code in them runs, and no header is trusted."""

from __future__ import annotations

import math
import sys
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import SourceError

MOST_BYTES = 2 << 30
"""The largest memory of an array in bytes; compressed files may claim any size."""


def load_arrays(path: Path, wanted: Iterable[str]) -> tuple[dict[str, npt.NDArray[Any]], list[str]]:
    """Return the wanted arrays of an NPZ file that exist, and the names of all its arrays.

    Parameters
    ----------
    path : Path
        The file.
    wanted : iterable of str
        Names of arrays.

    Raises
    ------
    SourceError
        The file cannot be read, or an array's header does not fit its bytes.
    """
    try:
        with zipfile.ZipFile(path) as packed:
            keys = {entry.filename.removesuffix(".npy"): entry for entry in packed.infolist()}
            arrays = {}
            for key in keys.keys() & set(wanted):
                with packed.open(keys[key]) as entry:
                    arrays[key] = _array(path, entry, f"'{key}'", keys[key].file_size)
            return arrays, list(keys)
    except SourceError:
        raise
    except Exception as fault:  # NumPy, zipfile, zlib and tokenize raise many classes of errors for damaged data
        raise SourceError(path, f"cannot be read as NumPy arrays: {fault}") from None


def array_shapes(path: Path) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Return a dict from array name to shape and type in an NPZ file, by the headers; an NPY file has the name "".

    Raises
    ------
    SourceError
        The file cannot be read.
    """
    try:
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:
                return {"": _header(file)}
        found = {}
        with zipfile.ZipFile(path) as packed:
            for entry in packed.infolist():
                if entry.filename.endswith(".npy"):
                    with packed.open(entry) as part:
                        found[entry.filename.removesuffix(".npy")] = _header(part)
        return found
    except Exception as fault:
        raise SourceError(path, f"cannot be read as NumPy arrays: {fault}") from None


def load_array(path: Path) -> npt.NDArray[Any]:
    """Return the array of an NPY file; raise SourceError if it cannot be read or is truncated."""
    try:
        with path.open("rb") as file:
            return _array(path, file, "the file", path.stat().st_size)
    except SourceError:
        raise
    except Exception as fault:
        raise SourceError(path, f"cannot be read as NumPy arrays: {fault}") from None


def array_names(path: Path) -> list[str]:
    """Return the names of an NPZ file's arrays; empty if the file cannot be read."""
    try:
        with zipfile.ZipFile(path) as packed:
            return [name.removesuffix(".npy") for name in packed.namelist()]
    except Exception:  # zipfile raises many classes of errors for damaged data; the file's reader reports the fault
        return []


def _array(path: Path, file: IO[bytes], what: str, size: int) -> npt.NDArray[Any]:
    """Return an array in NPY format of `size` bytes in all, after a check of its header against them."""
    shape, dtype = _header(file)
    numbers = math.prod(shape)
    if numbers * dtype.itemsize != size - file.tell():
        raise SourceError(
            path,
            f"{what} must hold {' × '.join(map(str, shape))} values of {dtype} by its header, and holds "
            f"{size - file.tell()} bytes; is it cut off?",
        )
    if numbers * 8 > MOST_BYTES:
        most = f"{MOST_BYTES / 1e9:.1f} GB"
        raise SourceError(
            path, f"{what} takes {numbers * 8 / 1e9:.1f} GB in memory; write shorter takes, of {most} at most"
        )
    file.seek(0)
    array: npt.NDArray[Any] = np.lib.format.read_array(file, allow_pickle=False)
    if dtype.kind == "U" and array.size and _letters(array).max(initial=0) > sys.maxunicode:
        raise SourceError(path, f"{what} has letters that are none: its texts are damaged")
    return array


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    version = np.lib.format.read_magic(file)
    read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read_header(file)
    return shape, dtype


def _letters(texts: npt.NDArray[np.str_]) -> npt.NDArray[np.uint32]:
    """Return the code points of texts, since invalid ones make Python fail later."""
    return np.ascontiguousarray(texts.astype(texts.dtype.newbyteorder("="))).view(np.uint32)
