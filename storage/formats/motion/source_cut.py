"""Define `SourceCut`, the input of writers: an interval to cut from a motion file, and the changes to apply."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kinedex.catalog.skeletons.mappings import Mappings


@dataclass(frozen=True)
class SourceCut:
    """An interval of a motion file in source frames, and the changes to apply to it.

    Attributes
    ----------
    source : Path
        The motion file.
    skeleton : Path or None
        The skeleton file of an AMC file; None for other formats.
    person : str or None
        The person in a file of several.
    start, stop : int
        The interval [start, stop) in frames of the source.
    source_rate_hz : float
        Frames per second of the source, as kinedex read it: the file's, or the user's.
    mirror : bool
        True to exchange left and right.
    rate_hz : float or None
        Frames per second of the cut; None for those of the source.
    in_place : bool
        True to put the root above the origin, facing +Z, in the first frame of `inner`.
    inner : tuple of int, optional
        The actual interval, in source frames, if the cut includes a margin around it.
    checksum : str, optional
        SHA-256 of the source when it was ingested; a source with another checksum is an error. None for no check.
    mappings : Mappings, optional
        The skeleton mappings that identify the source's left and right, for `mirror` and `in_place`; by default the
        shipped ones.
    """

    source: Path
    skeleton: Path | None
    person: str | None
    start: int
    stop: int
    source_rate_hz: float
    mirror: bool = False
    rate_hz: float | None = None
    in_place: bool = False
    inner: tuple[int, int] | None = None
    checksum: str | None = None
    mappings: Mappings | None = None

    @property
    def is_changed(self) -> bool:
        """True if numbers of the source change."""
        return self.mirror or self.in_place or self.rate_hz not in (None, self.source_rate_hz)
