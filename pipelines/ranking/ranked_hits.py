"""Define the templates of a ranking, the hits of each template, and the table of hits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pyarrow as pa

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.storage.snapshot.schemas import result_schema


@dataclass(frozen=True)
class RankedTemplate:
    """A template to rank with: its name in the results, and the keyframe queries that preselect frames for it."""

    name: str
    template: QuantisedTemplate
    queries: tuple[KeyframeQuery, ...] = ()


@dataclass(frozen=True)
class Hit:
    """A range of frames [start, stop) of a take that matches a template, or its mirror image, at distance `cost`."""

    take_id: int
    take: str
    start: int
    stop: int
    cost: float
    mirrored: bool = False


@dataclass(frozen=True)
class Ranking:
    """The hits of one template, with the work to find them; seconds are summed over all threads.

    Attributes
    ----------
    name : str
        The name of the template.
    hits : tuple of Hit
        The hits, the best first.
    frames : int
        The number of frames of all takes.
    searched : int
        The number of frames that keyframe queries kept; all frames without queries.
    computed : int
        The number of these frames in which distances were computed because no bound excluded a hit.
    bounded : bool
        True if a bound was computed.
    reading : float
        Seconds of the whole pass for listing takes, reading and coding words, and looking up keyframes.
    ranking : float
        Seconds for this template; for templates ranked together, its share in proportion to columns.
    """

    name: str
    hits: tuple[Hit, ...]
    frames: int
    searched: int
    computed: int
    bounded: bool
    reading: float
    ranking: float

    @property
    def skipped(self) -> float | None:
        """The fraction of the searched frames that a bound excluded; None if no bound was computed."""
        if not self.bounded:
            return None
        return max(0.0, 1 - self.computed / self.searched) if self.searched else 0.0

    @property
    def kept(self) -> float:
        """The fraction of all frames that keyframe queries kept; 1 without queries."""
        return self.searched / self.frames if self.frames else 0.0


def ranking_table(rankings: Iterable[Ranking], rate_hz: float, run: str = "") -> pa.Table:
    """Return hits as results of the kind `ranked_hits`, in the order of templates and ranks."""
    rows = [
        {
            "run": run,
            "template": ranking.name,
            "rank": place,
            "take_id": hit.take_id,
            "take": hit.take,
            "start": hit.start,
            "stop": hit.stop,
            "start_seconds": hit.start / rate_hz,
            "stop_seconds": hit.stop / rate_hz,
            "cost": hit.cost,
        }
        for ranking in rankings
        for place, hit in enumerate(ranking.hits, start=1)
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("ranked_hits"))
