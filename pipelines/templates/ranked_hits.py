"""Define the templates to rank by, and the ranking of a template: a table of hits, and the work to find them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.storage.snapshot.schemas import comparison_schema, ranking_schema


@dataclass(frozen=True)
class RankedTemplate:
    """A template to rank with: its name in the results, and the keyframe queries that preselect frames for it."""

    name: str
    template: QuantisedTemplate
    queries: tuple[KeyframeQuery, ...] = ()


@dataclass(frozen=True)
class Ranking:
    """The hits of one template, with the work to find them; seconds are summed over all threads.

    Attributes
    ----------
    name : str
        The name of the template.
    hits : pyarrow.Table
        The hits, the best first, with the columns of `ranking_schema`, or of `comparison_schema` for examples.
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
    hits: pa.Table
    frames: int
    searched: int
    computed: int
    bounded: bool
    reading: float
    ranking: float

    def __len__(self) -> int:
        """Return the number of hits."""
        return int(self.hits.num_rows)

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


def as_ranked(hits: pa.Table) -> pa.Table:
    """Return the hits of a template, the best first, with their ranks counted from 1."""
    column = hits.schema.get_field_index("rank")
    ranks = pa.array(np.arange(1, hits.num_rows + 1, dtype=np.int32))
    return hits.set_column(column, hits.schema.field(column), ranks)


def ranking_table(
    rankings: Iterable[Ranking], run: str = "", *, mirror: bool = False, compared: bool = False
) -> pa.Table:
    """Return hits as results of the kind `ranked_hits`, in the order of templates and ranks.

    Parameters
    ----------
    rankings : iterable of Ranking
        The rankings of the templates.
    run : str
        The id of the run.
    mirror : bool
        True to keep the column `mirrored`, which is not stored.
    compared : bool
        True if the hits were compared with examples, and have the columns of `comparison_schema`.
    """
    schema = comparison_schema() if compared else ranking_schema()
    hits = pa.concat_tables([schema.empty_table(), *(one.hits for one in rankings)]).combine_chunks()
    table = hits.set_column(0, hits.schema.field(0), pa.repeat(run, hits.num_rows))
    return table if mirror else table.drop_columns(["mirrored"])
