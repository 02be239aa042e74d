"""Read the clips that templates were learned from: their words, costs, and poses by template column."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.templates.templates import Template
from kinedex.ops.templates.warping import align
from kinedex.ops.words import ALL_KNOWN, NO_WORD, U64, bits
from kinedex.pipelines.annotation.threshold_calibration import Fold, fold_costs
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.learning import SubclassTemplate, TrainingClips
from kinedex.pipelines.templates.nearest_examples import mirrored_clips, words_of
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]
I64 = npt.NDArray[np.int64]


@dataclass(frozen=True)
class StoredClip:
    """A clip that a template was learned from.

    Attributes
    ----------
    place : int
        Its index among the clips of the template.
    name : str
        Its name: that of the take, with the interval if it is not the whole take.
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
