"""An interval of a source file, as the writers that cut a source's own channels take it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kinedex.catalog.skeletons.mappings import Mappings


@dataclass(frozen=True)
class SourceCut:
    """An interval of a motion file in its own frames, and the changes that are asked for.

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
        Frames per second of the source, as kinedex read it: those of the file, or those that the user stated.
    mirror : bool
        Exchange left and right.
    rate_hz : float or None
        Frames per second of the cut; those of the source for None.
    in_place : bool
        Put the root above the origin and turn it to +Z in the first frame of `inner`.
    inner : tuple of int, optional
        The interval that is meant, in frames of the source, where the cut includes its surroundings.
    checksum : str, optional
        SHA-256 of the source when it was ingested; a source of another content is an error. Not checked without it.
    mappings : Mappings, optional
        The skeleton mappings that tell the source's left from its right, for `mirror` and `in_place`; the shipped ones
        by default.
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
