"""Read the clips that templates were learned from, compare them with templates, and find those nearest to hits."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from kinedex.ops.arrays import F64, I64
from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.ops.templates.templates import Template
from kinedex.ops.templates.warping import align
from kinedex.ops.words import ALL_KNOWN, NO_WORD, U64, bits
from kinedex.pipelines.annotation.threshold_calibration import Fold, fold_costs
from kinedex.pipelines.engine.display import Progress, no_progress
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips
from kinedex.storage.store.store import Store

Key = tuple[str, str, int, int]
"""An annotated interval: take, class, start and stop."""

_MIRRORED = re.compile(r"(\d+) of \d+ clips are those of .* in the mirror")


@dataclass(frozen=True)
class StoredClip:
    """A clip that a template was learned from.

    Attributes
    ----------
    place : int
        The index of the clip among the clips of the template.
    name : str
        The name of the take, followed by the interval if the clip is not the whole take.
    take : str
        The take.
    start, stop : int
        The frames that were used for learning, without invalid ones at the ends.
    mirrored : bool
        True if left and right were exchanged.
    words : uint64 array (L,)
        The words that were used for learning.
    known : int
        The mask of the features known in the take.
    """

    place: int
    name: str
    take: str
    start: int
    stop: int
    mirrored: bool
    words: U64
    known: int = int(ALL_KNOWN)


def stored_clips(store: Store, template: SubclassTemplate) -> list[StoredClip]:
    """Return the clips of a template that still exist in the store, in order.

    Parameters
    ----------
    store : Store
        The store.
    template : SubclassTemplate
        The template, with the names of its clips.

    Returns
    -------
    list of StoredClip
        The clips, without those whose takes were removed or whose frames are now all invalid.
    """
    first_mirrored = len(template.clips) - mirrored_clips(template.origin)
    parts = [interval_of(name, store.take_ids) for name in template.clips]
    words = words_of(store, sorted({take for take, _ in parts if take in store.take_ids}))
    found = []
    for place, (name, (take, frames)) in enumerate(zip(template.clips, parts, strict=True)):
        own = words[take][frames] if take in words else np.empty(0, np.uint64)
        valid = np.flatnonzero(own != NO_WORD)
        if not len(valid):
            continue
        start = (frames.start or 0) + int(valid[0])
        inner, known = own[valid[0] : valid[-1] + 1], store.known.get(store.take_ids[take], int(ALL_KNOWN))
        mirrored = place >= first_mirrored
        if mirrored:
            inner, known = (
                store.feature_set.mirrored(inner),
                int(store.feature_set.mirrored(np.array([known], np.uint64))[0]),
            )
        found.append(StoredClip(place, name, take, start, start + len(inner), mirrored, inner, known))
    return found


def template_costs(templates: Sequence[SubclassTemplate], clips: Sequence[StoredClip], delta: float) -> F64:
    """Return the smallest distance of each template within each clip, computed as in annotation.

    Parameters
    ----------
    templates : sequence of SubclassTemplate
        T templates.
    clips : sequence of StoredClip
        C clips.
    delta : float
        Entries of a template within delta of 0 or 1 count, the others are wildcards.

    Returns
    -------
    float64 array (T, C)
        The smallest distances; ∞ if a clip is too short for a template, or lacks features that it needs.
    """
    each = tuple(TrainingClips("", (one.name,), (one.words,), known=one.known) for one in clips)
    return fold_costs(Fold(tuple(templates), each, delta))


def poses_of_columns(template: Template, clip: StoredClip) -> I64:
    """Return for each column of a template the frame of the clip's take with the corresponding pose.

    The clip is aligned with the template by classical dynamic time warping; if several frames are aligned with a
    column, the middle one is returned.

    Parameters
    ----------
    template : Template
        The template, with N columns.
    clip : StoredClip
        The clip.

    Returns
    -------
    int64 array (N,)
    """
    seen = bits(clip.words, template.values.shape[1]).astype(np.float64)
    local = np.abs(template.values[:, None, :] - seen[None, :, :]).mean(axis=2)
    path = align(local, np.ones(len(template)), np.ones(len(seen))).path
    columns = np.arange(len(template))
    first, last = np.searchsorted(path[:, 0], columns), np.searchsorted(path[:, 0], columns, side="right") - 1
    frames: I64 = clip.start + path[(first + last) // 2, 1]
    return frames


class LearnedFrom(Protocol):
    """A learned template: its subclass, the names of its clips, and its origin."""

    @property
    def subclass(self) -> str: ...
    @property
    def clips(self) -> tuple[str, ...]: ...
    @property
    def origin(self) -> str: ...


@dataclass(frozen=True)
class NearestExample:
    """An example clip: frames [start, stop) of a take, its distance from a hit, and its frame at each frame of the hit.

    `cost` and `frames` are those of `ops.templates.nearest_clip.NearestClip`.
    """

    take: str
    start: int
    stop: int
    cost: float
    frames: npt.NDArray[np.int64]


def nearest_examples(
    store: Store, hits: Mapping[Key, str | None], templates: Sequence[LearnedFrom], progress: Progress = no_progress
) -> dict[Key, NearestExample]:
    """Find the nearest example of each hit.

    Mirrored clips are not compared, because the store has only the original motion.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    hits : mapping of (take, class, start, stop) to str
        The subclass of each hit, which determines its template; hits without a subclass are excluded.
    templates : sequence of LearnedFrom
        Learned templates, with the names of their clips.
    progress : callable
        Returns a progress bar, given a description and a number of templates.

    Returns
    -------
    dict of (take, class, start, stop) to NearestExample
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
                found[hit] = NearestExample(*chosen[one.clip], one.cost, one.frames)
            bar.advance()
    return found


def clips_of(store: Store, template: LearnedFrom) -> list[tuple[str, int, int]]:
    """Return the clips of a template that exist in the store, as take, start and stop."""
    return clip_intervals(store, template.clips[: len(template.clips) - mirrored_clips(template.origin)])


def mirrored_clips(origin: str) -> int:
    """Return how many clips of a template are mirrored, according to its origin; they come after the others."""
    found = _MIRRORED.search(origin)
    return int(found[1]) if found else 0


def clip_intervals(store: Store, names: Sequence[str]) -> list[tuple[str, int, int]]:
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
