"""AMC files: the motion of Acclaim skeletons, as real archives write it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops import textnumbers as t
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.motion.asf import Skeleton
from kinedex.storage.formats.motion.reader import source_bytes


@dataclass(frozen=True)
class Motion:
    """The motion of an AMC file.

    Attributes
    ----------
    channels : float64 array (T, C)
        Radians and metres, in the column order of the skeleton.
    warnings : tuple of str
        Reservations about the file.
    """

    channels: npt.NDArray[np.float64]
    warnings: tuple[str, ...] = ()


def read_amc(path: str | Path, skeleton: Skeleton, data: bytes | None = None) -> Motion:
    """Read an AMC motion that belongs to a skeleton.

    Parameters
    ----------
    path : str or Path
        The file.
    skeleton : Skeleton
        Its skeleton.
    data : bytes, optional
        The file's bytes, if they have been read already.

    Raises
    ------
    SourceError
        The file is damaged; the error names the line of the first fault. No frame of such a file is used.
    """
    data = source_bytes(path, data)
    start, line, degrees = _amc_header(Path(path), data)
    names = [name for name, _ in skeleton.channels]
    widths = [len(dofs) for _, dofs in skeleton.channels]
    values, first, fault = t.parse_frames(data, start, line, names, widths)
    if fault is not None:
        raise SourceError(path, _explain(fault, data, skeleton), line=fault.line)
    if not len(values):
        raise SourceError(path, "no frames: the file ends after its header", line=line)
    turn, metres = np.pi / 180.0 if degrees else 1.0, skeleton.unit_m / skeleton.length_scale
    values *= [turn if dof in ("rx", "ry", "rz") else metres for _, dofs in skeleton.channels for dof in dofs]
    warnings = () if first == 1 else (f"frame numbers begin at {first}; its source frame here is 0",)
    return Motion(values, warnings)


def _amc_header(path: Path, data: bytes) -> tuple[int, int, bool]:
    """Return the byte and the line where the frames begin, and whether angles are degrees."""
    position, line, degrees = 0, 1, True
    while position < len(data):
        stop = next((i for i in range(position, len(data)) if data[i] in b"\r\n"), len(data))
        text = data[position:stop].decode("latin-1").strip()
        if text[:1].isdigit():
            return position, line, degrees
        if text.lower().startswith(":radians"):
            degrees = False
        elif text and text[0] not in ":#":
            raise SourceError(path, f"expected a frame number, got {text[:40]!r}", line=line)
        position = stop + (2 if data[stop : stop + 2] == b"\r\n" else 1)
        line += 1
    raise SourceError(path, "no frames: the file ends after its header", line=line)


def _explain(fault: t.Fault, data: bytes, skeleton: Skeleton) -> str:
    token = data[fault.start : min(fault.stop, fault.start + 40)].decode("latin-1")
    names = [name for name, _ in skeleton.channels]
    asf = os.path.basename(skeleton.path)
    match fault.code:
        case t.BAD_NUMBER:
            return f"not a number: {token!r}"
        case t.TOO_FEW:
            name, dofs = skeleton.channels[fault.start]
            return f"bone '{name}' has {fault.stop} numbers, {asf} gives it {len(dofs)} ({' '.join(dofs)})"
        case t.TOO_MANY:
            return f"unexpected {token!r} at the end of the line: more numbers than {asf} gives this bone"
        case t.UNKNOWN_NAME:
            if fault.stop == len(data):
                return f"the file ends in '{token}', in the middle of a frame: is it cut off?"
            return f"bone '{token}' is not in {asf}, or has no dof there{did_you_mean(token, names)}"
        case t.TWICE:
            return f"bone '{token}' stands twice in one frame"
        case t.MISSING:
            name = names[fault.start]
            if fault.stop:
                return f"the file ends in the middle of a frame: bone '{name}' is missing (is the file cut off?)"
            return f"the frame before this line lacks bone '{name}'"
        case t.NOT_NEXT:
            return f"frame {fault.stop} follows frame {fault.start}: frames are missing or out of order"
    return f"expected a frame number, got {token!r}"
