"""Bodies: the named joints of one source file over time, whatever format they came in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from catalog.skeletons import SkeletonMapping
from ops import kinematics
from storage.acclaim import RATE_HZ, Skeleton, read_amc, read_asf


@dataclass(frozen=True)
class Body:
    """The named joints of a take at its source rate.

    positions: float64 (J, 3, T), metres, Y up. orientation: float64 (4, T), the root's unit quaternion w x y z.
    rate_hz: frames per second. unit: what the file's lengths are in, in words. warnings: what a reader should know.
    """

    positions: npt.NDArray[np.float64]
    orientation: npt.NDArray[np.float64]
    rate_hz: float
    unit: str
    warnings: tuple[str, ...]

    @property
    def frames(self) -> int:
        """The number of source frames T."""
        return int(self.positions.shape[2])


@lru_cache(maxsize=64)
def _skeleton(path: str, _stamp: tuple[int, int], unit_m: float) -> Skeleton:
    return read_asf(path, unit_m)


def read_acclaim(
    amc: Path, asf: Path, mapping: SkeletonMapping, joints: tuple[str, ...], rate_hz: float = RATE_HZ
) -> Body:
    """Read an AMC file with its ASF skeleton.

    Parameters
    ----------
    joints: the named joints, in the order of the result. rate_hz: Acclaim files do not say their rate.

    Raises
    ------
    SourceError: file and line of the first fault in either file.
    """
    try:
        stat = asf.stat()
        stamp = (stat.st_size, stat.st_mtime_ns)
    except OSError:
        stamp = (0, 0)
    skeleton = _skeleton(str(asf), stamp, mapping.unit_m)
    motion = read_amc(amc, skeleton)
    nodes, matrices = kinematics.forward(skeleton.nodes, motion.channels)
    turned = np.einsum("abt,bc->act", matrices.reshape(3, 3, -1), skeleton.root_frame)
    # In our axes the root's orientation is the turn between the two frames' bases, seen from ours.
    turned = np.einsum("ab,bct,dc->adt", mapping.axes, turned, mapping.axes)
    return Body(
        positions=mapping.apply(str(asf), skeleton.bones, nodes, joints),
        orientation=kinematics.quaternions(np.ascontiguousarray(turned.reshape(9, -1))),
        rate_hz=rate_hz,
        unit=f"{skeleton.unit_m / skeleton.length_scale:.6g} m",
        warnings=motion.warnings,
    )
