"""Hits as every way of asking answers with them.

{take_id, take, start, stop, cost: number or null, mirrored, name}: the frames [start, stop) of a take, what they cost,
whether they fit the mirror image, and the template or query that found them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from kinedex.ops.errors import ParameterError
from kinedex.pipelines.explorer.addresses import Question
from kinedex.pipelines.explorer.selections import Selection, condition_of
from kinedex.pipelines.ranking.examples import ChosenInterval

if TYPE_CHECKING:
    from kinedex.pipelines.ranking.ranked_hits import Ranking
    from kinedex.storage.store.store import Store

MOST_HITS = 500
"""Most hits of one answer."""

Limit = Annotated[int, Field(ge=1, le=MOST_HITS)]


class ChosenHit(Question):
    """An interval of a take, by its id or its name: an example, or a hit that was accepted or rejected."""

    take_id: int | None = None
    take: str | None = None
    start: Annotated[int, Field(ge=0)]
    stop: Annotated[int, Field(ge=1)]
    mirrored: bool = False

    def interval(self, store: Store) -> ChosenInterval:
        """Return the interval as searches take it.

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
            raise ParameterError("start and stop", f"0 <= start < stop <= {frames}", [self.start, self.stop])
        return ChosenInterval(take_id, self.start, self.stop, self.mirrored)


def ranked_hits(ranking: Ranking) -> list[dict[str, Any]]:
    """Return the hits of a ranking, the best first."""
    return [
        {
            "take_id": one.take_id,
            "take": one.take,
            "start": one.start,
            "stop": one.stop,
            "cost": one.cost,
            "mirrored": one.mirrored,
            "name": ranking.name,
        }
        for one in ranking.hits
    ]


def take_condition(store: Store, selection: Selection) -> str | None:
    """Return the condition on takes of a selection as SQL, None for all takes."""
    condition = condition_of(selection, store.take_rows.column_names)
    return condition.removeprefix(" WHERE ") or None
