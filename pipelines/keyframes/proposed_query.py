"""Propose keyframe queries from an example, as YAML with comments for people to edit."""

from __future__ import annotations

import math

import numpy as np

from kinedex.catalog.configs import scalar
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.catalog.queries.query_writer import pose_text
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import shown_seconds
from kinedex.ops.search.query_proposal import SetCounts, propose_poses
from kinedex.ops.wording import counted
from kinedex.ops.words import ALL_KNOWN, I64, NO_WORD, TakeWords, cut
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.storage.store.store import Store


def propose_query(store: Store, take: str, start: int, stop: int, *, name: str = "proposed", keyframes: int = 3) -> str:
    """Propose a query for motions like an example, from the poses that distinguish it from the archive.

    Parameters
    ----------
    store : Store
        A store whose index is built; the vocabulary of the index gives the fraction of frames that show a pose.
    take : str
        The name of the take that contains the example.
    start, stop : int
        The frames [start, stop) of the example.
    name : str
        The name of the query.
    keyframes : int
        The largest number of keyframes.

    Returns
    -------
    str
        The text of a query file with one query, which finds the example itself.

    Raises
    ------
    StoreError
        If there is no take of that name, or no index.
    KinedexError
        If the range is not inside the take, or has no valid frame.
    """
    store.index_path()
    words: TakeWords = store.words([store.take_id(take)])
    if not 0 <= start < stop <= len(words.words):
        raise KinedexError(
            f"an example lies within [0, {len(words.words)}), the frames of {take}; got [{start}, {stop})"
        )
    clip = words.take(0)[start:stop]
    try:
        poses = propose_poses(clip, _counts(store, words.masks[0]), keyframes, words.masks[0])
    except KinedexError as fault:
        raise KinedexError(f"{take}, frames {start} to {stop}: {fault}") from None
    feature_set, rate_hz = store.feature_set, store.rate_hz
    body = [f"{scalar(name)}:", f"  description: {scalar(f'like {take}, frames {start} to {stop}')}", "  keyframes:"]
    for number, pose in enumerate(poses):
        at = start + pose.frame
        when = f"frame {at} of the take ({shown_seconds(at, rate_hz)} s)"
        body.append(f"    # {when}; matches about {pose.share:.2%} of the archive")
        between = pose.frame - poses[number - 1].frame
        gap = f"after: {math.ceil(between / 2)} to {2 * between} frames, " if number else ""
        on, off = feature_set.named(pose.mask & pose.value), feature_set.named(pose.mask & ~pose.value)
        body.append(f"    - {{{gap}{pose_text(on, off, feature_set)}}}")
    query = parse_queries("\n".join(body), feature_set, "the proposal", rate_hz)
    hits = search_store(store, query)
    frames = int(np.sum(hits.column("stop").to_numpy() - hits.column("start").to_numpy()))
    total = int(store.takes()["frames"].sum())
    head = [
        f"# Proposed from {stop - start} frames of {_comment(take)}, [{start}, {stop}).",
        "# Each keyframe fixes the features that set its pose apart from the rest of this archive; all others may be",
        "# on or off. Remove features to find more, add some to find less; `after` is the time since the keyframe",
        "# before, from half to twice that of the example.",
        f"# This query finds {counted(hits.num_rows, 'range')} in "
        f"{counted(len(set(hits.column('take').to_pylist())), 'take')}, "
        f"{frames / max(total, 1):.2%} of all frames.",
    ]
    return "\n".join([*head, *body]) + "\n"


def _counts(store: Store, known: int) -> list[SetCounts]:
    """Return the number of frames of each word of each feature set, in takes with the features known in the example."""
    counts = []
    if known != ALL_KNOWN:
        words = store.words([take for take in store.take_frames if not known & ~store.known.get(take, known)]).words
        for one in store.feature_set.sets.values():
            every, times = np.unique(cut(words[words != NO_WORD], one.first, one.count), return_counts=True)
            counts.append(SetCounts(one.first, one.count, every, times))
        return counts
    for word_set in store.feature_set.sets.values():
        table = store.sql("SELECT word, frames FROM vocabulary WHERE feature_set = ?", [word_set.name])
        frames: I64 = table.column("frames").to_numpy().astype(np.int64)
        words = table.column("word").to_numpy().astype(np.uint64)
        counts.append(SetCounts(word_set.first, word_set.count, words, frames))
    return counts


def _comment(text: str) -> str:
    """Return a text without characters that would end a comment line."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)
