"""Open an HDF5 file in a separate process, because a damaged file can crash the library that reads it.

The module `hdf5` runs this program as `python hdf5_child.py FILE [NAME…]`. Without names, the program prints a
description of the data sets and attributes as JSON; with names, it writes these data sets to its output, as an NPZ
file. An error is reported in one line on standard error.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import h5py
import numpy as np

MAX_NAMES = 20_000
"""The largest number of data sets in a file."""

_MAX_TEXT = 2_000


def describe(path: str) -> dict[str, Any]:
    """Return the data sets of a file, with shape and type, and the short attributes of its groups.

    Links, and data sets whose values are in other files, are excluded.
    """
    datasets: dict[str, Any] = {}
    attributes: dict[str, Any] = {}
    with h5py.File(path, "r") as file:

        def note(name: str, item: Any) -> None:
            if len(datasets) + len(attributes) >= MAX_NAMES:
                raise ValueError(f"has more than {MAX_NAMES} data sets")
            if isinstance(item, h5py.Dataset) and not item.is_virtual and item.external is None:
                fields = list(item.dtype.names or ())
                kinds = [item.dtype[field].kind for field in fields] or [item.dtype.kind]
                datasets[name] = {"shape": list(item.shape or ()), "kinds": kinds, "fields": fields}
            for key in list(item.attrs)[:100]:
                value = plain(item.attrs, key)
                if value is not None:
                    attributes.setdefault(name, {})[key] = value

        note("", file)
        file.visititems(note)
    return {"datasets": datasets, "attributes": attributes}


def plain(attributes: Any, key: str) -> str | float | list[str] | None:
    """Return an attribute that is a short text, one number, or a short list of texts; None for any other."""
    if attributes.get_id(key).get_storage_size() > _MAX_TEXT:
        return None
    value = attributes[key]
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.reshape(())[()]
    if isinstance(value, np.ndarray) and value.ndim == 1 and value.dtype.kind in "SO":
        texts = [one.decode("utf-8", "replace") if isinstance(one, bytes) else one for one in value.tolist()]
        return [one.rstrip("\0 ") for one in texts] if all(isinstance(one, str) for one in texts) else None
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        return str(value)[:_MAX_TEXT].rstrip("\0 ")
    return float(value) if isinstance(value, int | float | np.number) else None


def read(path: str, names: list[str]) -> dict[str, Any]:
    """Return data sets by name, floats as float64 and integers as int64; "name/field" names a field of a compound."""
    found = {}
    with h5py.File(path, "r") as file:
        for i, name in enumerate(names):
            parent, _, field = name.rpartition("/")
            item = file[parent].fields(field)[:] if name not in file else file[name][()]
            found[str(i)] = np.asarray(item, np.int64 if item.dtype.kind in "iu" else np.float64)
    return found


def main() -> int:
    """Run the program, and return its exit status."""
    path, names = sys.argv[1], sys.argv[2:]
    try:
        if names:
            np.savez(sys.stdout.buffer, **read(path, names))
        else:
            json.dump(describe(path), sys.stdout)
    except Exception as fault:  # the library raises many classes of errors for damaged or unusual files
        print(str(fault).splitlines()[0][:300] if str(fault) else type(fault).__name__, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
