"""Define the form of hits in the answers of all searches, and label hits.

{take_id, take, start, stop, cost: number or null, mirrored, similarity: number or null, probable: boolean or null,
name}: the frames [start, stop) of a take, their cost, whether they match the mirror image, their similarity to the
examples of a search, and the name of the template or query that found them.

`POST /api/ask/labelled` {hits: [interval]} → {labels: [[{class, verdict, share}]]}: for each interval the labels of
 people that overlap it by at least half of the shorter of the two.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field
from starlette.requests import Request

from kinedex.explorer.endpoints import RequestBody, post
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import Selection, columns_with_nan, condition_of, takes_only_selection
from kinedex.ops.errors import ParameterError
from kinedex.ops.intervals import Hit, Interval
from kinedex.storage.snapshot.stored_labels import is_of_limbs
from kinedex.storage.store.store import Store

MAX_HITS = 500
"""Maximum number of hits of one answer."""

SHARED = 0.5
"""Minimum overlap, as a fraction of the shorter interval, at which a label counts for a hit; the page uses it, too."""

Limit = Annotated[int, Field(ge=1, le=MAX_HITS)]


class ChosenHit(RequestBody):
    """An interval of a take, by its id or its name: an example, or a hit that was accepted or rejected."""

    take_id: int | None = None
    take: str | None = None
    start: Annotated[int, Field(ge=0)]
    stop: Annotated[int, Field(ge=1)]
    mirrored: bool = False

    def hit(self, store: Store) -> Hit:
        """Check the interval, and return it as an argument of searches.

        Raises
        ------
        KinedexError
            The store has no such take.
        ParameterError
            No take is named, or the interval is not within it.
        """
        if (self.take_id is None) == (self.take is None):
            raise ParameterError("take_id", "given, or `take`, the name", self.take_id)
        take_id = store.take_id(self.take) if self.take is not None else self.take_id
        frames = store.take_frames.get(take_id or 0)
        if take_id is None or frames is None:
            raise ParameterError("take_id", "the id of a take; it may have been removed from the store", take_id)
        if not self.start < self.stop <= frames:
            expected = f"0 <= start < stop <= {frames}, the frames of {store.take_names[take_id]}"
            raise ParameterError("start and stop", expected, [self.start, self.stop])
        return Hit(Interval(store.take_names[take_id], self.start, self.stop), mirrored=self.mirrored)


class HitLabelsRequest(RequestBody):
    """A request for the labels of hits."""

    hits: Annotated[tuple[ChosenHit, ...], Field(max_length=MAX_HITS)]


def find_labels(archive: Archive, asked: HitLabelsRequest, _request: Request) -> dict[str, Any]:
    """Return the labels of each hit, by the fraction of overlap, the largest first."""
    store = archive.store()
    places = [one.hit(store).interval for one in asked.hits]
    rows = store.labels()
    wanted = pa.array({one.take for one in places}, rows.schema.field("take").type)
    by_take: dict[str, list[dict[str, Any]]] = {}
    for row in rows.filter(pc.is_in(rows.column("take"), wanted)).to_pylist():
        if not is_of_limbs(row):
            by_take.setdefault(row["take"], []).append(row)
    labels = []
    for one in places:
        found: dict[tuple[str, str], float] = {}
        for row in by_take.get(one.take, ()):
            length = min(one.stop, row["stop"]) - max(one.start, row["start"])
            share = length / min(one.frames, row["stop"] - row["start"])
            key = (row["class"], row["verdict"])
            if share >= SHARED and share > found.get(key, 0):
                found[key] = share
        labels.append(
            [
                {"class": name, "verdict": verdict, "share": round(share, 3)}
                for (name, verdict), share in sorted(found.items(), key=lambda pair: (-pair[1], pair[0]))
            ]
        )
    return {"labels": labels}


def shown_hits(store: Store, hits: Iterable[Hit]) -> list[dict[str, Any]]:
    """Return hits in the form that the module describes."""
    return [
        {
            "take_id": store.take_ids[one.interval.take],
            **one.interval._asdict(),
            "cost": one.cost,
            "mirrored": one.mirrored,
            "similarity": one.similarity,
            "probable": one.probable,
            "name": one.name,
        }
        for one in hits
    ]


def take_condition(store: Store, selection: Selection) -> str | None:
    """Return a selection as a SQL condition over columns of takes only; None if it selects all takes."""
    selection = takes_only_selection(store, selection)
    condition = condition_of(selection, store.take_rows.column_names, columns_with_nan(store))
    return condition.removeprefix(" WHERE ") or None


routes = [post("/api/ask/labelled", find_labels, HitLabelsRequest)]
