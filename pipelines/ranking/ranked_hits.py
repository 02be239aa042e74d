"""The templates that takes are ranked by, the hits of each, and their table."""

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
    """A range of frames [start, stop) of a take that a template, or its mirror image, fits at a distance `cost`."""

    take_id: int
    take: str
    start: int
    stop: int
    cost: float
    mirrored: bool = False


@dataclass(frozen=True)
class Ranking:
    """The hits of one template, with the work that they took; seconds are those of all threads added up.

    Attributes
    ----------
    name : str
        The name of the template.
    hits : tuple of Hit
        The hits, the best first.
    frames : int
        The frames of all takes.
    searched : int
        The frames that keyframe queries left, all of them without queries.
    computed : int
        The frames of these in which distances were computed, as no bound excluded a hit.
    bounded : bool
        True where a bound was tried.
    reading : float
        Seconds of the whole pass in which takes were listed, words read and coded, and keyframes looked up.
    ranking : float
        Seconds of this template; of templates that are ranked together, its share by columns.
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
        """The share of the searched frames that a bound excluded; None where no bound was tried."""
        if not self.bounded:
            return None
        return max(0.0, 1 - self.computed / self.searched) if self.searched else 0.0

    @property
    def kept(self) -> float:
        """The share of all frames that keyframe queries left, 1 without queries."""
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
