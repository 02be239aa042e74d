"""The nearest example clip of each hit, for the player: that of its template's clips which resembles it most."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.ops.words import U64
from kinedex.pipelines.engine.context import Progress, no_progress
from kinedex.pipelines.report.data import Segment, Template
from kinedex.pipelines.report.motions import MOST_BYTES, Motions
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.learning import SubclassTemplate
from kinedex.storage.store.store import Store

MOST_PIECES = 500
"""So many segments at most get a motion of their own, where that of their take is not embedded."""

Key = tuple[str, str, int, int]

_MIRRORED = re.compile(r"(\d+) of \d+ clips are those of .* in the mirror")


@dataclass(frozen=True)
class Example:
    """A clip as an example: the frames [start, stop) of a take, and for each frame of the hit the clip's frame."""

    take: str
    start: int
    stop: int
    cost: float
    frames: npt.NDArray[np.int64]


def with_hits(
    store: Store,
    motions: Motions,
    hits: Sequence[Segment],
    others: Sequence[Segment],
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
    hits : sequence of Segment
        Segments that the page must be able to play.
    others : sequence of Segment
        Further segments of the page; as many of them as fit get their motion, the first `MOST_PIECES` at most.
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
    played = {hit.key: hit for hit in (*hits, *others) if found.has(hit.take, hit.start, hit.stop)}
    near = nearest_examples(store, list(played.values()), templates, progress)
    found = found.with_near(store, [(one.take, one.start, one.stop, one.frames) for one in near.values()])
    return found, {key: place for place, key in enumerate(near)}


def nearest_examples(
    store: Store,
    hits: Sequence[Segment],
    templates: Sequence[Template | SubclassTemplate],
    progress: Progress = no_progress,
) -> dict[Key, Example]:
    """Find the nearest example of each hit.

    Clips in the mirror are not compared, since the store has their motion the other way round.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    hits : sequence of Segment
        The hits; their subclass names the template.
    templates : sequence of Template
        Learned templates, with the names of their clips.
    progress : callable
        Makes a progress bar of a description and a number of templates.

    Returns
    -------
    dict of (take, class, start, stop) to Example
        Hits whose template has no clip in the store are missing.
    """
    clips = {template.subclass: clips_of(store, template) for template in templates}
    grouped: dict[str, list[Segment]] = defaultdict(list)
    for hit in hits:
        if hit.subclass is not None and clips.get(hit.subclass) and hit.stop > hit.start:
            grouped[hit.subclass].append(hit)
    used = {hit.take for own in grouped.values() for hit in own}
    used |= {take for name in grouped for take, _, _ in clips[name]}
    words = words_of(store, sorted(used))
    found = {}
    with progress("nearest examples", len(grouped)) as bar:
        for name, own in grouped.items():
            chosen = clips[name]
            parts = [words[take][start:stop] for take, start, stop in chosen]
            near = nearest_clips(
                parts, [words[hit.take][hit.start : hit.stop] for hit in own], len(store.feature_set.features)
            )
            for hit, one in zip(own, near, strict=True):
                found[hit.key] = Example(*chosen[one.clip], one.cost, one.frames)
            bar.advance()
    return found


def clips_of(store: Store, template: Template | SubclassTemplate) -> list[tuple[str, int, int]]:
    """Return the clips of a template that the store has, as take, start and stop."""
    return stored_clips(store, template.clips[: len(template.clips) - mirrored_clips(template.origin)])


def mirrored_clips(origin: str) -> int:
    """Return how many clips of a template, the last ones, are those of another class in the mirror, by its origin."""
    found = _MIRRORED.search(origin)
    return int(found[1]) if found else 0


def stored_clips(store: Store, names: Sequence[str]) -> list[tuple[str, int, int]]:
    """Return the clips of these names that the store has, as take, start and stop."""
    found = []
    for take, frames in (interval_of(name, store.take_ids) for name in names):
        if take in store.take_ids:
            start, stop, _ = frames.indices(store.take_frames[store.take_ids[take]])
            if start < stop:
                found.append((take, start, stop))
    return found


def words_of(store: Store, names: Sequence[str]) -> Mapping[str, U64]:
    """Return the words of takes by their names."""
    ids = [store.take_ids[name] for name in names]
    words = store.words(ids)
    place = {take_id: index for index, take_id in enumerate(words.take_ids.tolist())}
    return {name: words.take(place[take_id]) for name, take_id in zip(names, ids, strict=True)}
