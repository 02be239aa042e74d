"""The request for an export: the intervals to export, and the format and processing of their clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Literal

from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.storage.formats.data_set_folder import CLIPS, SPLITS

if TYPE_CHECKING:
    from kinedex.storage.formats.motion.channel_cuts import SourceCut
    from kinedex.storage.formats.motion.joint_motion import JointMotion

_MOTION = "kinedex.storage.formats.motion"

Kind = Literal["takes", "annotations", "labels", "hits", "ranges", "sql"]
SHARES = (0.8, 0.1, 0.1)
FORBID = {"extra": "forbid", "strict": True}
"""Settings of pydantic for requests from the explorer: unknown fields and values of other types are errors."""


@dataclass(frozen=True)
class FileFormat:
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
        resolve_name(self.joints)(path, motion)

    def cut_channels(self, paths: Sequence[Path], cut: SourceCut) -> None:
        """Write an interval of a source's own channels, to one file for each of `endings`."""
        from kinedex.storage.formats.motion.channel_cuts import unpacked_cut

        assert self.channels is not None
        with unpacked_cut(cut) as readable:
            resolve_name(self.channels)(paths, readable)


FILE_FORMATS = {
    "csv": FileFormat("joint positions as text", ("csv",), f"{_MOTION}.table_writer:write_csv"),
    "parquet": FileFormat("joint positions and words", ("parquet",), f"{_MOTION}.table_writer:write_parquet"),
    "npz": FileFormat(
        "joints, also in SMPL's order, and words, for numpy", ("npz",), f"{_MOTION}.table_writer:write_npz"
    ),
    "bvh": FileFormat(
        "the channels of a BVH source, or turns of a kinematic chain that is fitted to the joints",
        ("bvh",),
        f"{_MOTION}.bvh_writer:write_chain_bvh",
        channels=f"{_MOTION}.bvh_cuts:write_bvh_cut",
        sources=("bvh",),
    ),
    "amc": FileFormat(
        "the channels of an AMC source, and its ASF skeleton",
        ("amc", "asf"),
        channels=f"{_MOTION}.amc_cuts:write_amc_cut",
        sources=("amc",),
    ),
    "trc": FileFormat("joints as markers, for OpenSim and Pose2Sim", ("trc",), f"{_MOTION}.table_writer:write_trc"),
    "c3d": FileFormat("joints as points, for programs of motion capture", ("c3d",), f"{_MOTION}.c3d_writer:write_c3d"),
    "glb": FileFormat("glTF: skeleton, animation and a stick figure", ("glb",), f"{_MOTION}.gltf_writer:write_gltf"),
    "gif": FileFormat("a film of a stick figure, a minute at most", ("gif",), "kinedex.reports.film:write_gif"),
    "mp4": FileFormat("such a film of any length (kinedex[film])", ("mp4",), "kinedex.reports.film:write_mp4"),
}
"""The formats by name."""


def format_named(name: str) -> FileFormat:
    """Return a format by its name.

    Raises
    ------
    KinedexError
        There is no such format; the message lists the existing ones.
    """
    if name not in FILE_FORMATS:
        raise KinedexError(
            f"no export format '{name}'{did_you_mean(name, FILE_FORMATS)}; there are {', '.join(FILE_FORMATS)}"
        )
    return FILE_FORMATS[name]


@dataclass(frozen=True)
class IntervalSource:
    """The intervals to export.

    Attributes
    ----------
    kind : str
        Their source: whole takes, annotations, labels, saved hits, a file of ranges, or a SQL query.
    name : str or Path or None
        The name of the saved hits, the file of ranges, or the SQL query.
    takes : tuple of str
        Names of takes; empty for all.
    where : str or None
        A SQL filter over the columns of takes.
    classes : tuple of str
        Classes or subclasses of the intervals; empty for all.
    pipeline : str or None
        The pipeline, stage or run of the annotations; None for the current pipeline.
    min_confidence : float or None
        The least confidence; None for any.
    """

    __pydantic_config__ = FORBID

    kind: Kind = "takes"
    name: str | Path | None = None
    takes: tuple[str, ...] = ()
    where: str | None = None
    classes: tuple[str, ...] = ()
    pipeline: str | None = None
    min_confidence: float | None = None

    def __post_init__(self) -> None:
        if self.min_confidence is not None and not 0 <= self.min_confidence <= 1:
            raise ParameterError("min_confidence", "a number from 0 to 1", self.min_confidence)


def source_of(
    *, annotations: bool, labels: bool, hits: str | None, ranges: str | PathLike[str] | None, sql: str | None
) -> tuple[Kind, str | Path | None]:
    """Return the kind of the intervals and their name; whole takes if nothing is given.

    Parameters
    ----------
    annotations, labels : bool
        True for annotated segments, and for the labels of people.
    hits : str or None
        The name of saved hits.
    ranges : str, os.PathLike or None
        A file of ranges.
    sql : str or None
        A query.

    Raises
    ------
    KinedexError
        More than one source is given.
    """
    given: dict[Kind, str | Path | None] = {}
    given |= {"annotations": None} if annotations else {}
    given |= {"labels": None} if labels else {}
    given |= {} if hits is None else {"hits": hits}
    given |= {} if ranges is None else {"ranges": Path(ranges)}
    given |= {} if sql is None else {"sql": sql}
    if len(given) > 1:
        one, other, *_ = given
        raise KinedexError(f"{one} and {other} are two sources of clips: give one, or join them in sql")
    return next(iter(given.items()), ("takes", None))


@dataclass(frozen=True)
class ClipOptions:
    """The format and processing of clips.

    Attributes
    ----------
    form : str
        Name of the format, one of `FILE_FORMATS`.
    joints : bool
        Write the 24 joints even if the source's own channels could be exported in this format.
    margin : float
        Seconds added before and after each interval.
    context : float
        Further seconds before and after, which are in the files; the metadata gives the inner interval.
    min_length : float
        Least duration of an interval in seconds, without margins.
    mirror : bool
        Add a copy of each clip with left and right exchanged.
    rate_hz : float or None
        Frames per second of the files; None for the rate of the store, or of the source's channels.
    in_place : bool
        Move and turn each clip to start above the origin, facing +Z.
    split : str or None
        Column of takes; takes with the same value are in the same split.
    shares : tuple of float
        Shares of training, validation and test in the total duration; two values are those of training and test.
    seed : int
        Seed of the choice among equally good splits, and of the clips that are kept for balance.
    balance : bool
        In each split, keep as many clips of each class as the rarest class has.
    per_class : int or None
        The largest number of clips of a class; None for all.
    distinct : float or None
        Exclude clips whose joints differ from those of an earlier clip by less than this, in metres.
    """

    __pydantic_config__ = FORBID

    form: str = "csv"
    joints: bool = False
    margin: float = 0.0
    context: float = 0.0
    min_length: float = 0.0
    mirror: bool = False
    rate_hz: float | None = None
    in_place: bool = False
    split: str | None = None
    shares: tuple[float, ...] = SHARES
    seed: int = 0
    balance: bool = False
    per_class: int | None = None
    distinct: float | None = None

    def __post_init__(self) -> None:
        format_named(self.form)
        for name in ("margin", "context", "min_length"):
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ParameterError(name, "seconds from 0", value)
        if self.rate_hz is not None and not 0 < self.rate_hz <= 10_000:
            raise ParameterError("rate_hz", "frames per second above 0, at most 10,000", self.rate_hz)
        if len(self.shares) not in (2, 3) or not all(0 < share < float("inf") for share in self.shares):
            raise ParameterError("shares", "two or three numbers above 0, such as 0.8,0.1,0.1", self.shares)
        if self.per_class is not None and self.per_class < 1:
            raise ParameterError("per_class", "at least 1", self.per_class)
        if self.distinct is not None and not 0 < self.distinct < float("inf"):
            raise ParameterError("distinct", "metres above 0", self.distinct)

    @property
    def folders(self) -> tuple[str, ...]:
        """The folders that contain the clips."""
        if self.split is None:
            return (CLIPS,)
        return SPLITS if len(self.shares) == 3 else (SPLITS[0], SPLITS[2])
