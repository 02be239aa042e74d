"""Find the nearest example of each hit: the clip of its template that is most similar to it."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.ops.words import U64
from kinedex.pipelines.engine.display import Progress, no_progress
from kinedex.pipelines.templates.examples import interval_of
from kinedex.storage.store.store import Store

Key = tuple[str, str, int, int]
"""An annotated interval: take, class, start and stop."""

_MIRRORED = re.compile(r"(\d+) of \d+ clips are those of .* in the mirror")


class Learned(Protocol):
    """A learned template: its subclass, the names of its clips, and its origin."""

    @property
    def subclass(self) -> str: ...
    @property
    def clips(self) -> tuple[str, ...]: ...
    @property
    def origin(self) -> str: ...


@dataclass(frozen=True)
class Example:
    """An example clip: the frames [start, stop) of a take, and the frame of the clip for each frame of the hit."""

    take: str
    start: int
    stop: int
    cost: float
    frames: npt.NDArray[np.int64]


def nearest_examples(
    store: Store, hits: Mapping[Key, str | None], templates: Sequence[Learned], progress: Progress = no_progress
) -> dict[Key, Example]:
    """Find the nearest example of each hit.

    Mirrored clips are not compared, because the store has only the original motion.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    hits : mapping of (take, class, start, stop) to str
        The subclass of each hit, which determines its template; hits without one are left out.
    templates : sequence of Learned
        Learned templates, with the names of their clips.
    progress : callable
        Returns a progress bar, given a description and a number of templates.

    Returns
    -------
    dict of (take, class, start, stop) to Example
        The nearest example of each hit; hits whose template has no clip in the store are missing.
    """
    clips = {template.subclass: clips_of(store, template) for template in templates}
    grouped: dict[str, list[Key]] = defaultdict(list)
    for hit, subclass in hits.items():
        if subclass is not None and clips.get(subclass) and hit[3] > hit[2]:
            grouped[subclass].append(hit)
    used = {take for own in grouped.values() for take, *_ in own}
    used |= {take for name in grouped for take, _, _ in clips[name]}
    words = words_of(store, sorted(used))
    found = {}
    with progress("nearest examples", len(grouped)) as bar:
        for name, own in grouped.items():
            chosen = clips[name]
            parts = [words[take][start:stop] for take, start, stop in chosen]
            shown = [words[take][start:stop] for take, _, start, stop in own]
            near = nearest_clips(parts, shown, len(store.feature_set.features))
            for hit, one in zip(own, near, strict=True):
                found[hit] = Example(*chosen[one.clip], one.cost, one.frames)
            bar.advance()
    return found


def clips_of(store: Store, template: Learned) -> list[tuple[str, int, int]]:
    """Return the clips of a template that exist in the store, as take, start and stop."""
    return stored_clips(store, template.clips[: len(template.clips) - mirrored_clips(template.origin)])


def mirrored_clips(origin: str) -> int:
    """Return the number of a template's clips, at the end, that are mirrored, according to its origin."""
    found = _MIRRORED.search(origin)
    return int(found[1]) if found else 0


def stored_clips(store: Store, names: Sequence[str]) -> list[tuple[str, int, int]]:
    """Return the clips with the given names that exist in the store, as take, start and stop."""
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
