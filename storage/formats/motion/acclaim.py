"""Read Acclaim files: an AMC motion with its ASF skeleton."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import ClassVar

from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.amc import AmcFile
from kinedex.storage.formats.motion.asf import INCH_M, Skeleton, read_asf
from kinedex.storage.formats.motion.mapped_body import (
    mapped_orientation,
    posed,
    posed_bytes,
    recognition_evidence,
    refuse_far,
)
from kinedex.storage.formats.motion.reader import Body, Extent, MotionFile, Reader, ReadSettings, file_size


class AcclaimReader(Reader):
    """Reads AMC files, each with its ASF skeleton."""

    format: ClassVar[Format] = "acclaim"
    endings: ClassVar[tuple[str, ...]] = (".amc",)
    reads_whole: ClassVar[bool] = True

    def relevant_settings(self, settings: ReadSettings) -> object:
        """Return the rate, the only setting that affects the result."""
        return settings.acclaim_hz

    def extent(self, file: MotionFile, joints: int, settings: ReadSettings) -> Extent:
        """Count the frames and estimate the memory: the joints, and one block of the text."""
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
            unknown=fit.unknown,
            warnings=motion.warnings,
            evidence=recognition_evidence(fit),
        )


def fitted_skeleton(file: MotionFile, mappings: Mappings) -> tuple[Skeleton, Fit]:
    """Return the skeleton of an AMC file, in the unit of the mapping that fits it, and this mapping.

    Raises
    ------
    SourceError
        The skeleton is damaged or missing, or no mapping fits.
    """
    skeleton = _skeleton_of(file)
    fit = mappings.detect(Path(skeleton.path), "acclaim", skeleton.bones)
    if fit.mapping.unit_m not in (None, INCH_M):
        skeleton = _skeleton_of(file, fit.mapping.unit_m)
    return skeleton, fit


def _skeleton_of(file: MotionFile, unit_m: float = INCH_M) -> Skeleton:
    asf = file.skeleton
    if asf is None:
        raise SourceError(file.path, "an AMC file is read with its ASF skeleton; none is given")
    try:
        stat = asf.stat()
        stamp = (stat.st_size, stat.st_mtime_ns)
    except OSError:
        stamp = (0, 0)
    return _skeleton(str(asf), stamp, unit_m)


@lru_cache(maxsize=64)
def _skeleton(path: str, _stamp: tuple[int, int], unit_m: float) -> Skeleton:
    return read_asf(path, unit_m)
