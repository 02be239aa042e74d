"""Mutations of structure: files that are written rightly, but of which counts, columns, sections or types do not fit.

Where `tests.fuzz.mutations` changes bytes, these take a file apart (lines and columns, trees of JSON, YAML and XML,
arrays, markers), change one thing in all places where it stands, and put the file together again.
"""

from __future__ import annotations

import io
import json
import re
import tempfile
import warnings
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from PIL import Image

from tests.c3d_files import LABELS, standing_markers, write_c3d

EXTREMES = (
    *(0, -1, 1, 2, 3, 7, 255, 65535, 2**31 - 1, 2**31, 2**63, 10**30, -(10**9), 0.5, 1e-12, 1e-320, 1e9, 1e18, 1e308),
    *(float("nan"), float("inf"), -float("inf"), True, None, "", "nan", "0x10", "1e5", "a" * 5000, "\u202e\x1b[2J"),
    *([], {}, [[]], {"a": {"a": {}}}, [None] * 300),
)
"""Values for a leaf of a tree."""

_NUMBER = re.compile(rb"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?\Z")
_TEXT_EXTREMES = (
    b"0",
    b"-1",
    b"nan",
    b"inf",
    b"1e308",
    b"-1e308",
    b"1e-320",
    b"360",
    b"1e9",
    b"99999999999999999999",
    b"x",
)


# ---- tables: lines of columns ----------------------------------------------------------------------------


def table(data: bytes, random: Random) -> bytes:
    """Change a column, a block or a count of a text of lines and columns throughout."""
    lines = data.splitlines()
    separator = max((b"\t", b",", b" "), key=data.count)
    rows = [line.split(separator) for line in lines]
    if len(rows) < 2:
        return data
    change = random.choice((_column, _column, _block, _count, _sections, _exchange, _widths))
    change(rows, random)
    return b"\n".join(separator.join(row) for row in rows) + b"\n"


def _alike(rows: list[list[bytes]], random: Random) -> list[list[bytes]]:
    """Return the rows that have as many columns as one of them."""
    width = len(random.choice(rows))
    return [row for row in rows if len(row) == width]


def _column(rows: list[list[bytes]], random: Random) -> None:
    """Set, remove or double a column in all rows of one width, or in all but one."""
    alike = _alike(rows, random)
    place = random.randrange(len(alike[0]))
    what, value, spared = (
        random.randrange(4),
        random.choice(_TEXT_EXTREMES),
        random.choice((-1, random.randrange(len(alike)))),
    )
    for number, row in enumerate(alike):
        if number == spared or place >= len(row):
            continue
        if what == 0:
            del row[place]
        elif what == 1:
            row.insert(place, row[place])
        elif _NUMBER.match(row[place]):
            row[place] = value


def _block(rows: list[list[bytes]], random: Random) -> None:
    """Repeat a block of lines many times, or reverse it."""
    start = random.randrange(len(rows))
    block = rows[start : start + random.choice((1, 2, 5, 30, 200))]
    rows[start : start + len(block)] = random.choice((block[::-1], block * 2, block * 100, [], [*block, [b""]]))


def _count(rows: list[list[bytes]], random: Random) -> None:
    """Change a number of the header, which may count what follows."""
    header = [(row, i) for row in rows[:80] for i, cell in enumerate(row) if _NUMBER.match(cell)]
    if header:
        row, place = random.choice(header)
        row[place] = random.choice((row[place] + b"0", b"0", b"1", b"-" + row[place], b"1000000000", b"1e5", b"0.5"))


def _sections(rows: list[list[bytes]], random: Random) -> None:
    """Exchange two blocks, as where a section stands before the one that it needs."""
    first, second, third = sorted(random.randrange(len(rows) + 1) for _ in range(3))
    rows[first:third] = rows[second:third] + rows[first:second]


def _exchange(rows: list[list[bytes]], random: Random) -> None:
    """Exchange cells of two rows, such as the names of two bones."""
    for _ in range(random.choice((1, 5))):
        a, b = random.choice(rows), random.choice(rows)
        if a and b:
            i, j = random.randrange(len(a)), random.randrange(len(b))
            a[i], b[j] = b[j], a[i]


def _widths(rows: list[list[bytes]], random: Random) -> None:
    """Make one row shorter or longer than the others."""
    row = random.choice(rows)
    row[:] = random.choice((row[:-1], row[1:], row + row[-1:], row * 50, []))


# ---- trees -----------------------------------------------------------------------------------------------


def _change_tree(tree: Any, random: Random) -> Any:
    """Replace, remove, double, rename or exchange nodes of a tree of dicts and lists."""
    places = list(_places(tree))
    if not places:
        return random.choice(EXTREMES)
    for _ in range(random.choice((1, 1, 2, 4))):
        holder, key = random.choice(places)
        other, other_key = random.choice(places)
        try:
            match random.randrange(6):
                case 0:
                    holder[key] = random.choice(EXTREMES)
                case 1:
                    del holder[key]
                case 2 if isinstance(holder, list):
                    holder[key:key] = [holder[key]] * random.choice((1, 3, 500))
                case 3 if isinstance(holder, dict):
                    holder[random.choice((str(other_key), "", "a" * 300, "\x1b[2J", "on"))] = holder.pop(key)
                case 4:
                    holder[key], other[other_key] = other[other_key], holder[key]
                case _:
                    holder[key] = [holder[key]] if random.random() < 0.5 else {str(key): holder[key]}
        except (KeyError, IndexError):
            continue
    return tree


def _places(tree: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    waiting = [tree]
    while waiting and len(found) < 3000:
        node = waiting.pop()
        items = (
            list(node.items()) if isinstance(node, dict) else list(enumerate(node)) if isinstance(node, list) else []
        )
        found += [(node, key) for key, _ in items]
        waiting += [value for _, value in items]
    return found


def json_tree(data: bytes, random: Random) -> bytes:
    """Change the tree of a JSON file; what exchange has put into itself cannot be written, and stays as it was."""
    try:
        return json.dumps(_change_tree(json.loads(data), random), indent=random.choice((None, 1))).encode()
    except (ValueError, RecursionError):
        return data


def yaml_tree(data: bytes, random: Random) -> bytes:
    """Change the tree of a YAML file."""
    try:
        return yaml.safe_dump(_change_tree(yaml.safe_load(data), random), allow_unicode=True, sort_keys=False).encode()
    except (ValueError, RecursionError, yaml.YAMLError):
        return data


def xml_tree(data: bytes, random: Random) -> bytes:
    """Remove, double, exchange, rename or empty elements and attributes of an XML file."""
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError:
        return data
    for _ in range(random.choice((1, 2, 4))):
        parents = [node for node in root.iter() if len(node)]
        if not parents:
            break
        parent = random.choice(parents)
        place = random.randrange(len(parent))
        child = parent[place]
        match random.randrange(7):
            case 0:
                parent.remove(child)
            case 1:
                parent[place:place] = [child] * random.choice((1, 2, 50))
            case 2:
                other = random.choice(parents)
                if other not in child.iter() and parent not in other[0].iter():  # no element inside itself
                    parent[place], other[0] = other[0], child
            case 3:
                child.tag = random.choice([node.tag for node in root.iter()])
            case 4 if child.attrib:
                child.attrib[random.choice(list(child.attrib))] = random.choice(
                    ("", "nan", "-1", "ts1", "1e400", "9" * 30)
                )
            case 5 if child.attrib:
                del child.attrib[random.choice(list(child.attrib))]
            case _:
                child.text = random.choice((None, "", "\n", "x" * 10_000, "\u202e"))
    try:
        return ElementTree.tostring(root)
    except (RecursionError, TypeError):
        return data


# ---- arrays and markers ----------------------------------------------------------------------------------

_REFUSED = (ValueError, TypeError, IndexError, OverflowError, RuntimeError)
"""The errors of numpy where an array cannot be of a type: -1 of none without a sign, a date of no nine letters."""


def _change_array(array: np.ndarray, random: Random) -> np.ndarray:
    """Change shape, type, order or values of an array, which stays a right one."""
    axis = random.randrange(array.ndim) if array.ndim else 0
    match random.randrange(9):
        case 0:
            return array.astype(random.choice(("<f2", "<f4", ">f8", "<i2", "<u1", "<c16", "?", "<U9", "S5", "<M8[s]")))
        case 1:
            return np.asfortranarray(array) if array.ndim else array[None]
        case 2:
            return np.moveaxis(array, axis, 0)
        case 3:
            return np.take(array, [0] * random.choice((0, 1, 2, 2000)), axis=axis) if array.size else array
        case 4:
            return array.reshape(-1)
        case 5:
            return array[..., None]
        case 6 if array.dtype.kind == "f" and array.size:
            changed = np.moveaxis(array.copy(), axis, 0) if array.ndim else array.copy()
            value = random.choice((np.nan, np.inf, 1e308, 1e7, 0.0, 1e-320))
            changed[random.randrange(len(changed)) if changed.ndim else ...] = value
            return changed
        case 7:
            return array[:0] if array.ndim else array
        case _:
            return np.array(random.choice(("", "female", 0.0, 60, -1, 1e9, np.nan, [[]], ["root"] * 24)))


def npy_array(data: bytes, random: Random) -> bytes:
    """Change the array of an NPY file."""
    try:
        return _saved(_change_array(np.load(io.BytesIO(data)), random))
    except _REFUSED:
        return data


def npz_arrays(data: bytes, random: Random) -> bytes:
    """Change, exchange, remove or double arrays of an NPZ file."""
    file = io.BytesIO()
    with np.load(io.BytesIO(data)) as packed:
        arrays = dict(packed)
    if not arrays:
        return data
    name, other = random.choice(sorted(arrays)), random.choice(sorted(arrays))
    try:
        match random.randrange(6):
            case 0:
                arrays[name], arrays[other] = arrays[other], arrays[name]
            case 1:
                del arrays[name]
            case _:
                arrays[name] = _change_array(arrays[name], random)
        with zipfile.ZipFile(file, "w") as packed_again:
            for key, array in arrays.items():
                packed_again.writestr(zipfile.ZipInfo(f"{key}.npy"), _saved(array))
    except _REFUSED:
        return data
    return file.getvalue()


def _saved(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return file.getvalue()


def c3d_markers(data: bytes, random: Random) -> bytes:
    """Write a C3D file of other markers, rates, units, gaps and numbers of frames than a system would."""
    order = random.sample(range(len(LABELS)), random.choice((len(LABELS), len(LABELS), len(LABELS) - 1, 3, 1)))
    points = standing_markers(random.choice((1, 2, 5, 40)))[order] * random.choice((1000, 1000, 1, 1e-6, 1e6))
    names = [LABELS[place] for place in order]
    if random.random() < 0.5:
        lost = random.randrange(len(order)), slice(None), slice(random.randrange(points.shape[2]), None)
        points[lost] = random.choice((np.nan, 0.0, 1e30, np.inf))
    if random.random() < 0.5:
        place = random.randrange(len(names))
        names[place] = random.choice((names[place].lower(), f"s:{names[place]}", "", "*12", names[0], "\xe9"))
    with tempfile.TemporaryDirectory() as folder:
        path = write_c3d(
            Path(folder) / "a.c3d", points, tuple(names), rate=random.choice((120.0, 30.0, 30.0, 1e9, 1e-9)),
            unit=random.choice(("mm", "mm", "mm", "m", "", "parsec")), first=random.choice((0, 1, 65000)),
            analog=random.choice((0, 0, 2)),
        )  # fmt: skip
        return path.read_bytes()


def parquet_columns(data: bytes, random: Random) -> bytes:
    """Change a column of a Parquet file: its type, its values, its name, or whether it is there."""
    try:
        rows = pq.read_table(io.BytesIO(data))
    except (pa.ArrowException, OSError):
        return data
    names, columns = list(rows.column_names), list(rows.columns)
    place = random.randrange(len(names))
    values = columns[place].to_pylist()
    try:
        match random.randrange(5):
            case 0:
                columns[place] = pa.array([None if random.random() < 0.5 else value for value in values])
            case 1:
                columns[place] = columns[place].cast(random.choice((pa.string(), pa.float32(), pa.int8(), pa.bool_())))
            case 2:
                extreme = random.choice(
                    (*(one for one in EXTREMES if isinstance(one, float)), 2**62, -1, "a", "", b"\xff", [1])
                )
                columns[place] = pa.array(
                    [extreme if i == 3 or random.random() < 0.1 else None for i in range(len(values))]
                )
            case 3:
                names[place] = random.choice((*names, names[place].upper(), "person", "recording", "line", "row", ""))
            case _:
                del names[place], columns[place]
    except (pa.ArrowException, OverflowError):
        return data
    if not names:
        return data
    file = io.BytesIO()
    pq.write_table(pa.Table.from_arrays(columns, names), file)
    return file.getvalue()


def png_pixels(data: bytes, random: Random) -> bytes:
    """Write an image of another size, kind or content."""
    size = random.choice(((64, 48), (64, 48), (64, 48), (1, 1), (48, 64), (700, 500)))
    values = np.random.default_rng(random.randrange(100)).integers(0, random.choice((1, 2, 256)), size[::-1], np.uint8)
    image = Image.fromarray(values).convert(random.choice(("L", "1", "LA", "RGB", "RGBA", "P", "I;16")))
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=random.choice((0, 1)))
    return file.getvalue()


_OF_ENDING: dict[str, Callable[[bytes, Random], bytes]] = {
    ".json": json_tree, ".yaml": yaml_tree, ".eaf": xml_tree, ".osim": xml_tree, ".npy": npy_array, ".npz": npz_arrays,
    ".c3d": c3d_markers, ".parquet": parquet_columns, ".png": png_pixels,
}  # fmt: skip


def change_structure(data: bytes, ending: str, random: Random) -> bytes:
    """Change the structure of a file, by the ending of its name, once or twice."""
    change = _OF_ENDING.get(ending, table)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # numpy warns of values that a type cannot hold
        for _ in range(random.choice((1, 1, 2))):
            data = change(data, random)
    return data
