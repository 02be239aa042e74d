"""The request for an export: what is cut out of a store, and how."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal

from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.pipelines.export.forms import form_named

Kind = Literal["takes", "annotations", "labels", "hits", "ranges", "sql"]

SPLITS = ("train", "val", "test")
"""The names of splits, in the order of `Form.shares`; they are folders, too."""

CLIPS = "clips"
"""The folder of clips that are not split."""

SHARES = (0.8, 0.1, 0.1)

FORBID = {"extra": "forbid", "strict": True}
"""Requests of the explorer have no other fields than these."""


@dataclass(frozen=True)
class What:
    """The intervals that are cut out.

    Attributes
    ----------
    kind : str
        Their source: whole takes, annotations, labels, saved hits, a file of ranges, or a SQL query.
    name : str or Path or None
        The name of the saved hits, the file of ranges, or the SQL query.
    takes : tuple of str
        Names of takes; all unless given.
    where : str or None
        A SQL filter over the columns of takes.
    classes : tuple of str
        Only intervals of these classes or subclasses; all unless given.
    pipeline : str or None
        The pipeline, stage or run of the annotations; the current pipeline unless given.
    min_confidence : float or None
        Least confidence.
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
    """Return the kind of the intervals and their name; whole takes where nothing is given.

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
        There are two sources.
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
class How:
    """The form of the clips and what is done to them.

    Attributes
    ----------
    form : str
        Name of the form, one of `FORMS`.
    joints : bool
        Write the 24 joints even where the form could be cut from the source's own channels.
    margin : float
        Seconds that are added before and after each interval.
    context : float
        Seconds of surroundings that the files hold besides; the metadata name the inner interval.
    min_length : float
        Least seconds of an interval, without its margins.
    mirror : bool
        Add a twin of each clip with left and right exchanged.
    rate_hz : float or None
        Frames per second of the files; those of the store, or of the source's channels, for None.
    in_place : bool
        Begin each clip above the origin, facing +Z.
    split : str or None
        Column of takes: no value of it is in two of the splits.
    shares : tuple of float
        Shares of the seconds of training, validation and test; two are training and test.
    seed : int
        Another number makes another of the equally good splits, and balances with other clips.
    balance : bool
        In each split, take as many clips of each class as of the rarest one.
    per_class : int or None
        Most clips of a class.
    distinct : float or None
        Leave out clips whose joints differ from those of an earlier clip by less, in metres.
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
        form_named(self.form)
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
        """The folders that the clips lie in."""
        if self.split is None:
            return (CLIPS,)
        return SPLITS if len(self.shares) == 3 else (SPLITS[0], SPLITS[2])
