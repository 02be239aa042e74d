"""Read Acclaim files: an AMC motion, as real archives write it, with its ASF skeleton."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.body_evidence import Evidence
from kinedex.catalog.skeletons.limb_doubts import limb_doubts
from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.catalog.skeletons.root_units import OTHER_ROOT_UNIT, root_factor
from kinedex.catalog.skeletons.units import unlikely_height
from kinedex.ops import textnumbers as t
from kinedex.ops.errors import SourceError, did_you_mean
from kinedex.storage.formats.motion.asf import INCH_M, Skeleton, read_asf
from kinedex.storage.formats.motion.mapped_body import (
    mapped_orientation,
    posed,
    posed_bytes,
    recognition_evidence,
    refuse_far,
)
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings
from kinedex.storage.formats.motion.text_blocks import Block, RowFile, RowMemory, before_last_frame, blocks, changed
from kinedex.storage.formats.source_files import file_size, stamp_of

_LINE_END = re.compile(rb"\r\n?|\n")


class AmcFile(RowFile):
    """An AMC file that belongs to a skeleton, and is parsed block by block.

    Parameters
    ----------
    path : str or Path
        The file.
    skeleton : Skeleton
        Its skeleton.
    data : bytes, optional
        The file's bytes, if they have been read already.

    Attributes
    ----------
    frames : int
        The number of frames.
    start : int
        The byte at which the first frame begins.
    warnings : tuple of str
        Warnings about the file, complete once a block has been parsed.

    Raises
    ------
    SourceError
        The file has no frames, or cannot be read.
    """

    def __init__(self, path: str | Path, skeleton: Skeleton, data: bytes | None = None) -> None:
        self.path = Path(path)
        self.skeleton = skeleton
        self.warnings: tuple[str, ...] = ()
        self._data = data
        self.frames = self.start = 0
        for block in blocks(self.path, data, before_last_frame):
            if not block.start:
                self.start, self._line, self._degrees = _amc_header(block)
                self._data = block.data if block.last else None
            self.size = block.start + len(block.view)
            self.frames += t.count_rows(block.view, 0 if block.start else self.start, numbered=True)

    @property
    def columns(self) -> int:
        """The number of channels."""
        return sum(len(dofs) for _, dofs in self.skeleton.channels)

    def parsed(self, memory: RowMemory) -> Iterator[npt.NDArray[np.float64]]:
        skeleton, expected = self.skeleton, None
        names = [name for name, _ in skeleton.channels]
        widths = [len(dofs) for _, dofs in skeleton.channels]
        turn, metres = np.pi / 180.0 if self._degrees else 1.0, skeleton.unit_m / skeleton.length_scale
        kinds = [dof for _, dofs in skeleton.channels for dof in dofs]
        scale = np.array([turn if dof in ("rx", "ry", "rz") else metres for dof in kinds])
        source = blocks(self.path, self._data, before_last_frame)
        for block in source:
            start, line = (0, 1) if block.start else (self.start, self._line)
            room = memory.free(len(block.view))
            values, first, fault = t.parse_frames(block.view, start, line, names, widths, room)
            # every block but the first begins with a line that holds a frame number
            numbered = fault is None or (fault.code, fault.line) != (t.BAD_NUMBER, line)
            if expected is not None and numbered and first != expected:
                fault = t.Fault(t.NOT_NEXT, line, expected - 1, first)
            elif fault is not None and fault.code == t.MISSING and fault.stop and not block.last:
                fault = replace(fault, stop=0)
                after = next(source)
                _, _, other = t.parse_frames(after.view, 0, 1, names, widths)
                if other is not None and (other.code, other.line) == (t.BAD_NUMBER, 1):
                    fault, block = other, after  # the first fault of the whole file is the number of the next frame
            if fault is not None:
                raise self._error(fault, block)
            if len(values):
                if expected is None and first != 1:
                    self.warnings = (f"frame numbers begin at {first}; its source frame here is 0",)
                expected = first + len(values)
                memory.filled += len(values)
                values *= scale
                yield values
        if expected is None:
            raise SourceError(self.path, "no frames: the file ends after its header", line=self._line)

    def _error(self, fault: t.Fault, block: Block) -> SourceError:
        """Return the SourceError for a fault in a block."""
        if fault.code == t.FULL:
            return changed(self.path)
        return SourceError(self.path, _explain(fault, block.data, self.skeleton), line=fault.line + block.line - 1)


def _amc_header(block: Block) -> tuple[int, int, bool]:
    """Return the byte and the line at which the frames begin, and True if angles are in degrees."""
    data, position, line, degrees = block.view, 0, 1, True
    while position < len(data):
        end = _LINE_END.search(data, position)
        text = bytes(data[position : end.start() if end else len(data)]).decode("latin-1").strip()
        if text[:1].isdigit():
            return position, line, degrees
        if text.lower().startswith(":radians"):
            degrees = False
        elif text and text[0] not in ":#":
            raise SourceError(block.path, f"expected a frame number, got {text[:40]!r}", line=line)
        position = end.end() if end else len(data)
        line += 1
    if block.last:
        raise SourceError(block.path, "no frames: the file ends after its header", line=line)
    return position, line, degrees


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


class AcclaimReader(Reader):
    """Reads AMC files, each with its ASF skeleton."""

    format: ClassVar[Format] = "acclaim"
    endings: ClassVar[tuple[str, ...]] = (".amc",)
    reads_whole: ClassVar[bool] = True

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rate, the only setting that affects the result."""
        return settings.acclaim_hz

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames and estimate the memory of the joints and one block of the text."""
        skeleton = _skeleton_of(file)
        motion = AmcFile(file.path, skeleton, file.data)
        need = posed_bytes(motion.frames, file_size(file.path), len(skeleton.nodes), joints)
        return Extent(motion.frames, need, settings.acclaim_hz)

    def read(self, file: MotionFile, mappings: Mappings, joints: tuple[str, ...], settings: ReadSettings) -> Body:
        """Read an AMC file with its ASF skeleton.

        Raises
        ------
        SourceError
            Either file is damaged, or no mapping fits; the error names file and line of the first fault.
        """
        skeleton, fit = fitted_skeleton(file, mappings)
        motion = AmcFile(file.path, skeleton, file.data)
        positions, matrices = posed(motion, skeleton.nodes, 0, fit, joints)
        refuse_far(file.path, positions, joints, fit.unknown)
        return Body(
            positions=positions,
            orientation=mapped_orientation(fit, matrices, skeleton.root_frame),
            rate_hz=settings.acclaim_hz,
            unit=f"{skeleton.unit_m / skeleton.length_scale:.6g} m",
            skeleton=fit.mapping.name,
            up=fit.up,
            unknown=fit.unknown,
            warnings=(*motion.warnings, *_doubts(skeleton, fit, positions, joints)),
            evidence=recognition_evidence(fit),
        )


def _doubts(skeleton: Skeleton, fit: Fit, positions: npt.NDArray[np.float64], joints: tuple[str, ...]) -> list[str]:
    """Return warnings on the skeleton: its names, bones without length, its unit, and the unit of the root."""
    found = list(fit.doubts)
    needed = set(fit.nodes)
    for i in reversed(fit.nodes):
        while (i := skeleton.nodes[i].parent) >= 0 and i not in needed:
            needed.add(i)
    empty = [skeleton.nodes[i].name for i in sorted(needed - {0}) if not skeleton.nodes[i].after.any()]
    if empty:
        found.append(f"bones of its skeleton have no length, which may be wrong: {', '.join(empty)}")
    height = unlikely_height(positions, joints, 1.0)
    if height is not None:
        found.append(
            f"the unit of its skeleton is doubtful: {Path(skeleton.path).name} states a `length` of "
            f"{skeleton.length_scale:g}, which makes the body {height:.2f} m high"
        )
    factor = root_factor(positions, joints)
    if factor is not None:
        found.append(f"{OTHER_ROOT_UNIT}: times {factor:.4g} its feet would stand on the floor")
    return [*found, *limb_doubts(positions, joints)]


def fitted_skeleton(file: MotionFile, mappings: Mappings) -> tuple[Skeleton, Fit]:
    """Return the skeleton of an AMC file, in the unit of the mapping that fits it, and this mapping.

    Raises
    ------
    SourceError
        The skeleton is damaged or missing, or no mapping fits.
    """
    skeleton = _skeleton_of(file)
    evidence = Evidence(
        tuple(skeleton.bones), np.empty((len(skeleton.nodes), 3, 0)), tuple(node.parent for node in skeleton.nodes)
    )
    fit = mappings.renamed("acclaim", evidence) or mappings.detect(Path(skeleton.path), "acclaim", skeleton.bones)
    if fit.mapping.unit_m not in (None, INCH_M):
        skeleton = _skeleton_of(file, fit.mapping.unit_m)
    return skeleton, fit


def _skeleton_of(file: MotionFile, unit_m: float = INCH_M) -> Skeleton:
    asf = file.skeleton
    if asf is None:
        raise SourceError(file.path, "an AMC file is read with its ASF skeleton; none is given")
    return _skeleton(str(asf), stamp_of(asf), unit_m)


@lru_cache(maxsize=64)
def _skeleton(path: str, _stamp: tuple[int, int], unit_m: float) -> Skeleton:
    return read_asf(path, unit_m)
