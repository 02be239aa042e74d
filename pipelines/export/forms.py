"""The formats of exported files: extensions, and writers from joints or from the channels of a source."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from kinedex.ops.errors import KinedexError, did_you_mean

if TYPE_CHECKING:
    from kinedex.storage.formats.motion.joint_motion import JointMotion
    from kinedex.storage.formats.motion.source_cut import SourceCut

_MOTION = "kinedex.storage.formats.motion"


@dataclass(frozen=True)
class Form:
    """A format of exported files; writers are named "module:function" and imported when first used.

    Attributes
    ----------
    meaning : str
        Its description, for lists of formats.
    endings : tuple of str
        Endings of the files of one clip, without the dot. A writer from joints writes the first one.
    joints : str or None
        Function of (path, JointMotion) that writes the 24 joints; None if there is none.
    channels : str or None
        Function of (paths, SourceCut) that writes an interval of a source's own channels, with one path for each of
        `endings`; None if there is none.
    sources : tuple of str
        Formats of takes (column `format`) whose channels `channels` can cut.
    """

    meaning: str
    endings: tuple[str, ...]
    joints: str | None = None
    channels: str | None = None
    sources: tuple[str, ...] = ()

    def write_joints(self, path: Path, motion: JointMotion) -> None:
        """Write a motion of joints to a file."""
        assert self.joints is not None
        write: Callable[[Path, JointMotion], None] = _function(self.joints)
        write(path, motion)

    def cut_channels(self, paths: Sequence[Path], cut: SourceCut) -> None:
        """Write an interval of a source's own channels, to one file for each of `endings`."""
        assert self.channels is not None
        write: Callable[[Sequence[Path], SourceCut], None] = _function(self.channels)
        write(paths, cut)


FORMS = {
    "csv": Form("joint positions as text", ("csv",), f"{_MOTION}.table_writer:write_csv"),
    "parquet": Form("joint positions and words", ("parquet",), f"{_MOTION}.table_writer:write_parquet"),
    "npz": Form("joints, also in SMPL's order, and words, for numpy", ("npz",), f"{_MOTION}.npz_writer:write_npz"),
    "bvh": Form(
        "the channels of a BVH source, or turns of a kinematic chain that is fitted to the joints",
        ("bvh",),
        f"{_MOTION}.bvh_writer:write_chain_bvh",
        channels=f"{_MOTION}.bvh_cuts:write_bvh_cut",
        sources=("bvh",),
    ),
    "amc": Form(
        "the channels of an AMC source, and its ASF skeleton",
        ("amc", "asf"),
        channels=f"{_MOTION}.amc_cuts:write_amc_cut",
        sources=("amc",),
    ),
    "trc": Form("joints as markers, for OpenSim and Pose2Sim", ("trc",), f"{_MOTION}.trc_writer:write_trc"),
    "c3d": Form("joints as points, for programs of motion capture", ("c3d",), f"{_MOTION}.c3d_writer:write_c3d"),
    "glb": Form("glTF: skeleton, animation and a stick figure", ("glb",), f"{_MOTION}.gltf_writer:write_gltf"),
    "gif": Form("a film of a stick figure, a minute at most", ("gif",), "kinedex.reports.film:write_gif"),
    "mp4": Form("such a film of any length (kinedex[film])", ("mp4",), "kinedex.reports.film:write_mp4"),
}
"""The formats by name."""


def form_named(name: str) -> Form:
    """Return a format by its name.

    Raises
    ------
    KinedexError
        There is no such format; the message lists the existing ones.
    """
    if name not in FORMS:
        raise KinedexError(f"no export format '{name}'{did_you_mean(name, FORMS)}; there are {', '.join(FORMS)}")
    return FORMS[name]


def _function(place: str) -> Callable[..., None]:
    module, _, name = place.partition(":")
    function: Callable[..., None] = getattr(import_module(module), name)
    return function
