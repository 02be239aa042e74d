"""Write Acclaim files: ASF skeletons and AMC motion, in the dialects of real archives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.ops.synth.body import Body
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.motion.asf import INCH_M

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]
Columns = Sequence[tuple[str, tuple[str, ...]]]

_BLOCK = 4096  # frames that are formatted at once


@dataclass(frozen=True)
class Dialect:
    """The conventions of a capture studio's files.

    Attributes
    ----------
    newline : str
        End of line.
    length : float
        The ASF's unit, a divisor of inches.
    decimals : int
        Digits after the decimal point.
    scientific : bool
        True to write numbers with an exponent.
    remarks : tuple of str
        Comment lines at the head of both files, Latin-1.
    """

    newline: str = "\n"
    length: float = 0.45
    decimals: int = 5
    scientific: bool = False
    remarks: tuple[str, ...] = ()


def write_asf(path: Path, body: Body, name: str, dialect: Dialect) -> None:
    """Write a skeleton as an ASF file atomically, replacing an existing file.

    Parameters
    ----------
    path : Path
        The file.
    body : Body
        The body, lengths in metres.
    name : str
        Name of the skeleton.
    dialect : Dialect
        Dialect of the file.
    """
    lines = [f"# {remark}" for remark in dialect.remarks]
    lines += [
        ":version 1.10", f":name {name}", ":units", "  mass 1.0", f"  length {dialect.length:g}", "  angle deg",
        ":documentation", "   Synthetic skeleton: nobody's measures.",
        ":root", "   order TX TY TZ RX RY RZ", "   axis XYZ", "   position 0 0 0", "   orientation 0 0 0", ":bonedata",
    ]  # fmt: skip
    for number, bone in enumerate(body.bones, 1):
        direction = " ".join(f"{value:.9g}" for value in bone.direction)
        axis = " ".join(f"{value:.9g}" for value in bone.axis)
        lines += ["  begin", f"     id {number}", f"     name {bone.name}", f"     direction {direction}"]
        lines += [f"     length {bone.length / INCH_M * dialect.length:.9g}", f"     axis {axis}  XYZ"]
        if bone.dofs:
            limits = ["(-180.0 180.0)"] * len(bone.dofs)
            lines += [
                "    dof " + " ".join(bone.dofs),
                "    limits " + limits[0],
                *("           " + one for one in limits[1:]),
            ]
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    for parent in ("root", *(bone.name for bone in body.bones)):
        children = [bone.name for bone in body.bones if bone.parent == parent]
        if children:
            lines.append(f"    {parent} " + " ".join(children))
    lines.append("  end")
    with whole_file(path) as unfinished:
        unfinished.write_bytes(dialect.newline.join([*lines, ""]).encode("latin-1"))


def write_amc(path: Path, columns: Columns, table: F64, dialect: Dialect) -> int:
    """Write motion as an AMC file atomically, replacing an existing file.

    Parameters
    ----------
    path : Path
        The file.
    columns : sequence of (str, tuple of str)
        Bone and degrees of freedom of every line of a frame; the root's first three are its position.
    table : float64 array (T, n)
        Metres and degrees.
    dialect : Dialect
        Dialect of the file.

    Returns
    -------
    int
        The file's size in bytes.
    """
    if table.ndim != 2 or table.shape[1] != sum(len(dofs) for _, dofs in columns):
        raise ParameterError("table", "one column for every dof", table.shape)
    values = table.copy()
    values[:, :3] *= dialect.length / INCH_M
    head = [f"# {remark}" for remark in dialect.remarks] + [":FULLY-SPECIFIED", ":DEGREES", ""]
    parts = [dialect.newline.join(head).encode("latin-1")]
    parts += [
        _frames(values[start : start + _BLOCK], start + 1, columns, dialect) for start in range(0, len(values), _BLOCK)
    ]
    data = b"".join(parts)
    with whole_file(path) as unfinished:
        unfinished.write_bytes(data)
    return len(data)


def _frames(values: F64, first: int, columns: Columns, dialect: Dialect) -> bytes:
    """Return the text of frames: fields of fixed width, of which only the bytes marked as written are kept."""
    frames = len(values)
    numbers = np.arange(first, first + frames, dtype=np.int64)
    texts, kept = (_scientific if dialect.scientific else _fixed)(values, dialect.decimals)
    newline = dialect.newline.encode()
    pieces = [_digits(numbers), _same(newline, frames)]
    column = 0
    for name, dofs in columns:
        pieces.append(_same(name.encode(), frames))
        for _ in dofs:
            pieces += [_same(b" ", frames), (texts[:, column], kept[:, column])]
            column += 1
        pieces.append(_same(newline, frames))
    text = np.concatenate([piece for piece, _ in pieces], axis=1)
    mask = np.concatenate([mask for _, mask in pieces], axis=1)
    data: bytes = text[mask].tobytes()
    return data


def _same(text: bytes, frames: int) -> tuple[U8, npt.NDArray[np.bool_]]:
    shape = (frames, len(text))
    return np.broadcast_to(np.frombuffer(text, np.uint8), shape), np.broadcast_to(True, shape)


def _digits(numbers: npt.NDArray[np.int64], least: int = 1) -> tuple[U8, npt.NDArray[np.bool_]]:
    """Return non-negative integers as characters, at least `least` digits, and a mask of the characters to write."""
    width = max(least, len(str(int(numbers.max(initial=0)))))
    digits = np.empty((*numbers.shape, width), np.uint8)
    rest = numbers
    for place in range(width - 1, -1, -1):
        tens = rest // 10
        digits[..., place] = rest - tens * 10
        rest = tens
    kept = np.maximum.accumulate(digits > 0, axis=-1)
    kept[..., width - least :] = True
    return digits + np.uint8(48), kept


def _signed(values: F64) -> tuple[U8, npt.NDArray[np.bool_]]:
    return np.full((*values.shape, 1), ord("-"), np.uint8), (values < 0)[..., None]


def _point(shape: tuple[int, ...], text: bytes = b".") -> tuple[U8, npt.NDArray[np.bool_]]:
    return np.broadcast_to(np.frombuffer(text, np.uint8), (*shape, len(text))), np.broadcast_to(
        True, (*shape, len(text))
    )


def _joined(pieces: list[tuple[U8, npt.NDArray[np.bool_]]]) -> tuple[U8, npt.NDArray[np.bool_]]:
    return np.concatenate([piece for piece, _ in pieces], -1), np.concatenate([mask for _, mask in pieces], -1)


def _fixed(values: F64, decimals: int) -> tuple[U8, npt.NDArray[np.bool_]]:
    """Return numbers with a fixed number of decimals as characters, and a mask of the characters to write."""
    scaled = np.rint(np.abs(values) * 10.0**decimals).astype(np.int64)
    whole = scaled // 10**decimals
    fraction = scaled - whole * 10**decimals
    return _joined([_signed(values), _digits(whole), _point(values.shape), _digits(fraction, decimals)])


def _scientific(values: F64, decimals: int) -> tuple[U8, npt.NDArray[np.bool_]]:
    """Return numbers with a mantissa and a three-digit exponent, as old Windows programs write them, and a mask.

    Numbers below 1e-99 in magnitude are written as zero.
    """
    sizes = np.abs(values)
    exponent = np.floor(np.log10(np.maximum(sizes, 1e-99))).astype(np.int64)
    exponent[sizes < 1e-99] = 0
    scaled = np.rint(sizes / 10.0**exponent * 10.0**decimals).astype(np.int64)
    over = scaled >= 10 ** (decimals + 1)
    scaled[over] //= 10
    exponent[over] += 1
    whole = scaled // 10**decimals
    sign = np.where(exponent < 0, np.uint8(ord("-")), np.uint8(ord("+")))[..., None]
    return _joined([
        _signed(values), _digits(whole), _point(values.shape), _digits(scaled - whole * 10**decimals, decimals),
        _point(values.shape, b"e"), (sign, np.broadcast_to(True, sign.shape)), _digits(np.abs(exponent), 3),
    ])  # fmt: skip
