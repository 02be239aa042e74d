"""The motions of hits and of their nearest examples, for the player of a page."""

from __future__ import annotations

from collections.abc import Sequence

from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.engine.display import Progress, no_progress
from kinedex.pipelines.templates.stored_clips import Key, nearest_examples
from kinedex.reports.data import Template
from kinedex.reports.motions import MOST_BYTES, Motions
from kinedex.storage.store.store import Store

MOST_PIECES = 500
"""Maximum number of segments that are embedded as motions of their own, because their whole takes are not embedded."""


def with_hits(
    store: Store,
    motions: Motions,
    hits: Sequence[TakeSegment],
    others: Sequence[TakeSegment],
    templates: Sequence[Template],
    progress: Progress = no_progress,
) -> tuple[Motions, dict[Key, int]]:
    """Add the motions of hits to those of a page, and the nearest examples of all segments that it can play.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    motions : Motions
        The motions of the page.
    hits : sequence of TakeSegment
        Segments that the page must be able to play.
    others : sequence of TakeSegment
        Further segments of the page; the motions of as many as fit are added, of the first `MOST_PIECES` at most.
    templates : sequence of Template
        Learned templates, with the names of their clips.
    progress : callable
        Makes a progress bar of a description and a number of templates.

    Returns
    -------
    motions : Motions
        With the further motions.
    near : dict of (take, class, start, stop) to int
        The place of each nearest example in `motions.near`.
    """
    found = motions.with_pieces(store, ((hit.take, hit.start, hit.stop) for hit in hits))
    further = others[:MOST_PIECES]
    found = found.with_pieces(store, ((one.take, one.start, one.stop) for one in further), most=MOST_BYTES)
    played = {hit.key: hit.subclass for hit in (*hits, *others) if found.has(hit.take, hit.start, hit.stop)}
    near = nearest_examples(store, played, templates, progress)
    found = found.with_near(store, [(one.take, one.start, one.stop, one.frames) for one in near.values()])
    return found, {key: place for place, key in enumerate(near)}
