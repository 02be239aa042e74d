"""Bodies: the named joints of one source file over time, whatever format they came in."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.skeletons.mappings import Fit, Format, Mappings
from kinedex.ops.body import kinematics
from kinedex.ops.errors import SourceError
from kinedex.storage.formats.motion.acclaim import INCH_M, RATE_HZ, Skeleton, read_amc, read_asf
from kinedex.storage.formats.motion.amass import holds_poses, read_amass
from kinedex.storage.formats.motion.body import (
    FARTHEST_M,
    NOTHING_GIVEN,
    Body,
    Given,
    built,
    orientation,
    refuse_far,
    to_metres,
)
from kinedex.storage.formats.motion.bvh import Bvh, parse_bvh
from kinedex.storage.formats.motion.points import read_c3d, read_positions

__all__ = ["FARTHEST_M", "FORMS", "NOTHING_GIVEN", "READ_WHOLE", "Body", "Given", "form_of", "read_body"]

F64 = npt.NDArray[np.float64]

_WORKED_ON = 2_000_000  # nodes times frames at once: some 50 MB of positions, whatever the file's size


FORMS: dict[str, Format] = {
    ".amc": "acclaim", ".bvh": "bvh", ".c3d": "c3d",
    ".trc": "positions", ".csv": "positions", ".npz": "positions", ".npy": "positions",
}  # fmt: skip
"""Endings of motion files that are read, and the format of the mappings that they are read with; .npz: also "amass"."""


def form_of(motion: str | Path) -> Format:
    """The format of a motion file by its ending, which must be one of `FORMS`, and of an .npz by what is in it."""
    ending = Path(motion).suffix.lower()
    return "amass" if ending == ".npz" and holds_poses(Path(motion)) else FORMS[ending]


READ_WHOLE = (".amc", ".bvh")
"""Endings of files that are read at once, which `read_body` therefore takes the bytes of."""


def read_body(
    motion: Path,
    asf: Path | None,
    mappings: Mappings,
    joints: tuple[str, ...],
    given: Given = NOTHING_GIVEN,
    data: bytes | None = None,
) -> Body:
    """Read a motion file of any format, told by its ending.

    Parameters
    ----------
    asf: the skeleton of an AMC file; other formats have none. given: what the user says of its rate.
    data: the bytes of a file of `READ_WHOLE`, where they have been read already.

    Raises
    ------
    SourceError: file and line of the first fault.
    """
    form = form_of(motion)
    if form == "bvh":
        return read_bvh(motion, mappings, joints, given, data)
    if form == "positions":
        return read_positions(motion, mappings, joints, given)
    if form == "c3d":
        return read_c3d(motion, mappings, joints, given)
    if form == "amass":
        return read_amass(motion, mappings, joints, given)
    if asf is None:
        raise SourceError(motion, "an AMC file is read with its ASF skeleton; none is given")
    return read_acclaim(motion, asf, mappings, joints, given.acclaim_hz, data)


@lru_cache(maxsize=64)
def _skeleton(path: str, _stamp: tuple[int, int], unit_m: float) -> Skeleton:
    return read_asf(path, unit_m)


def read_acclaim(
    amc: Path,
    asf: Path,
    mappings: Mappings,
    joints: tuple[str, ...],
    rate_hz: float = RATE_HZ,
    data: bytes | None = None,
) -> Body:
    """Read an AMC file with its ASF skeleton.

    Parameters
    ----------
    joints: the named joints, in the order of the result. rate_hz: Acclaim files do not say their rate.
    data: the bytes of the AMC file, where they have been read already.

    Raises
    ------
    SourceError: file and line of the first fault in either file.
    """
    try:
        stat = asf.stat()
        stamp = (stat.st_size, stat.st_mtime_ns)
    except OSError:
        stamp = (0, 0)
    skeleton = _skeleton(str(asf), stamp, INCH_M)
    fit = mappings.detect(asf, "acclaim", skeleton.bones)
    if fit.mapping.unit_m not in (None, INCH_M):
        skeleton = _skeleton(str(asf), stamp, fit.mapping.unit_m)
    motion = read_amc(amc, skeleton, data)
    nodes, matrices = kinematics.forward(skeleton.nodes, motion.channels, wanted=fit.nodes)
    positions = fit.apply(nodes, joints)
    refuse_far(amc, positions, joints, fit.unknown)
    return Body(
        positions=positions,
        orientation=orientation(fit, matrices, skeleton.root_frame),
        rate_hz=rate_hz,
        unit=f"{skeleton.unit_m / skeleton.length_scale:.6g} m",
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=(*motion.warnings, *built(fit)),
    )


def read_bvh(
    path: Path,
    mappings: Mappings,
    joints: tuple[str, ...],
    given: Given = NOTHING_GIVEN,
    data: bytes | None = None,
) -> Body:
    """Read a BVH file, which carries its own skeleton and rate.

    Parameters
    ----------
    mappings: those that its skeleton is looked for in. joints: the named joints, in the order of the result.
    given: a rate that counts in place of the file's. data: the file's bytes, where they have been read already.

    Raises
    ------
    SourceError: file and line of the first fault, or that no mapping fits.
    """
    bvh = parse_bvh(path, data)
    fit = mappings.detect(path, "bvh", bvh.places)
    nodes, restored = _restore(bvh, fit)
    positions, turned = _track(nodes, bvh.channels, fit, joints)
    warnings = [*bvh.warnings, *built(fit)]
    rate_hz = given.rate_of(bvh.rate_hz, warnings)
    if restored:
        warnings.append(
            f"bones {', '.join(restored)} have no length in the file; mapping '{fit.mapping.name}' gives them one"
        )
    unit = to_metres(path, positions, fit.mapping.unit_m, joints, warnings)
    refuse_far(path, positions, joints, fit.unknown)
    return Body(
        positions=positions,
        orientation=orientation(fit, turned),
        rate_hz=rate_hz,
        unit=unit,
        skeleton=fit.mapping.name,
        unknown=fit.unknown,
        warnings=tuple(warnings),
    )


def _restore(bvh: Bvh, fit: Fit) -> tuple[tuple[kinematics.Node, ...], list[str]]:
    """The nodes with the lengths that a mapping gives to bones whose OFFSET is zero, and the names of those bones."""
    nodes, restored = list(bvh.nodes), []
    for name, weights in fit.mapping.bones.items():
        index = fit.places[name]
        moved = any(step.kind >= kinematics.MOVE_X for step in nodes[index].steps)
        if not moved and not nodes[index].before.any():
            offset = sum(weight * bvh.nodes[fit.places[other]].before for other, weight in weights.items())
            nodes[index] = replace(nodes[index], before=np.asarray(offset))
            restored.append(name)
    return tuple(nodes), restored


def _track(nodes: tuple[kinematics.Node, ...], channels: F64, fit: Fit, joints: tuple[str, ...]) -> tuple[F64, F64]:
    """Named joints (J, 3, T) in the file's unit and the root's rotation (9, T), worked on a stretch at a time."""
    frames = len(channels)
    positions, turned = np.empty((len(joints), 3, frames)), np.empty((9, frames))
    step = max(kinematics.BLOCK, _WORKED_ON // len(nodes))
    for start in range(0, frames, step):
        stop = start + step
        part, turned[:, start:stop] = kinematics.forward(nodes, channels[start:stop], fit.root, fit.nodes)
        positions[:, :, start:stop] = fit.apply(part, joints)
    return positions, turned
