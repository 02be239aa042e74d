"""Read what an archive gives to annotation methods: examples and unlabelled takes, with words or positions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from kinedex.ops.body.facing_direction import mirrored_positions
from kinedex.ops.words import ALL_KNOWN, NO_WORD
from kinedex.pipelines.annotation.methods import LabelledMotion, Motion, Needs
from kinedex.pipelines.templates.examples import Rejected, interval_of
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips
from kinedex.storage.store.store import Store

MAX_FRAMES = 100_000
"""The most frames of unlabelled takes that are read with positions (56 minutes, 58 MB)."""

PIECE_FRAMES = 300
"""Pieces of this length, evenly spread over the takes in order of name, are read of an archive with more frames."""


def template_examples(store: Store, templates: Sequence[SubclassTemplate], needs: Needs) -> list[LabelledMotion]:
    """Return the clips that templates were learned from, each once, without those that the store has no more."""
    found: dict[str, LabelledMotion] = {}
    for one in templates:
        for name in one.clips:
            take, frames = interval_of(name, store.take_ids)
            if take in store.take_ids and name not in found:
                start, stop, _ = frames.indices(store.take_frames[store.take_ids[take]])
                found[name] = LabelledMotion(label=one.subclass, take=take, start=start, stop=stop)
    words = store.words(sorted({store.take_ids[one.take] for one in found.values()}))
    places = {take_id: place for place, take_id in enumerate(words.take_ids.tolist())}
    read = []
    for _, clip in sorted(found.items()):
        take_id = store.take_ids[clip.take]
        own = words.take(places[take_id])[clip.start : clip.stop]
        read.append(replace(clip, words=own, known=store.known.get(take_id, int(ALL_KNOWN))))
    return _with_positions(store, read) if needs.positions else read


def clip_examples(
    store: Store, clips: Sequence[TrainingClips], rejected: Sequence[Rejected], needs: Needs
) -> list[LabelledMotion]:
    """Return the clips of all subclasses in their order, and the rejected intervals after them."""
    found = [
        LabelledMotion(
            label=one.subclass, take=take, start=start, stop=start + len(words), words=words, known=one.known,
            mirrored=place >= len(one.names) - one.mirrored,
        )
        for one in clips
        for place, (take, start, words) in enumerate(zip(one.of_takes, one.of_starts, one.words, strict=True))
    ]  # fmt: skip
    found += [
        LabelledMotion(
            label=one.label, take=one.take, start=one.start, stop=one.stop, words=one.words, known=one.known,
            positive=False,
        )
        for one in rejected
    ]  # fmt: skip
    return _with_positions(store, found) if needs.positions else found


def _with_positions(store: Store, examples: Sequence[LabelledMotion]) -> list[LabelledMotion]:
    """Return examples with their positions."""
    joints = store.feature_set.joints
    read = store.positions([(store.take_ids[one.take], one.start, one.stop) for one in examples])
    found = []
    for one, own in zip(examples, read, strict=True):
        positions = own.astype(np.float64)
        if len(one.words) < len(positions):  # invalid frames of a rejected interval are cut out
            positions = positions[store.words([store.take_ids[one.take]]).words[one.start : one.stop] != NO_WORD]
        found.append(replace(one, positions=mirrored_positions(positions, joints) if one.mirrored else positions))
    return found


def unlabelled_takes(store: Store, needs: Needs) -> Iterator[Motion]:
    """Yield all takes of an archive with their words; of positions, at most `MAX_FRAMES`, whole or in pieces."""
    if not needs.positions:
        words = store.words()
        masks = [int(ALL_KNOWN)] * len(words) if words.known is None else words.known.tolist()
        yield from (Motion(words=words.take(place), known=mask) for place, mask in enumerate(masks))
        return
    pieces = unlabelled_pieces(list(store.take_ids.values()), store.take_frames)
    for (take_id, start, stop), own in zip(pieces, store.positions(pieces), strict=True):
        one = Motion(positions=own.astype(np.float64), known=store.known.get(take_id, int(ALL_KNOWN)))
        yield replace(one, words=store.words([take_id]).words[start:stop]) if needs.words else one


def unlabelled_pieces(take_ids: Sequence[int], frames: dict[int, int]) -> list[tuple[int, int, int]]:
    """Return ranges (take_id, start, stop) of at most `MAX_FRAMES` frames: all takes, or pieces that are evenly spread.

    Parameters
    ----------
    take_ids : sequence of int
        The takes in order of name.
    frames : dict of int to int
        The length of each take.
    """
    if sum(frames[one] for one in take_ids) <= MAX_FRAMES:
        return [(one, 0, frames[one]) for one in take_ids if frames[one]]
    pieces = [
        (one, start, min(start + PIECE_FRAMES, frames[one]))
        for one in take_ids
        for start in range(0, frames[one], PIECE_FRAMES)
    ]
    ends = np.cumsum([stop - start for _, start, stop in pieces])
    chosen = np.searchsorted(ends, np.linspace(0, ends[-1], MAX_FRAMES // PIECE_FRAMES, endpoint=False), side="right")
    return [pieces[place] for place in np.unique(chosen).tolist()]
