"""The learned keyframe queries of a store, as poses with the frames of a training clip that show them.

`GET /api/queries?stage=` → {stages: [name], stage, queries: [{name, class, origin, precision, recall, fitness, runs,
 clips, text, query: {name, poses: [{on, off}], gaps: [{low, high}]} or null, sentence, seen}]}. `seen` is null, or
 {take_id, take, frames: [frame of each pose]}: the first training clip in which the query finds something.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from kinedex.catalog.queries.keyframe_query import KeyframeQuery, WordPattern, word_pattern
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.explorer.addresses import get
from kinedex.explorer.answers import NotFoundError
from kinedex.explorer.keyframes import model_of
from kinedex.explorer.same import command_line
from kinedex.explorer.template_use import learning_stages
from kinedex.ops.words import NO_WORD, U64
from kinedex.pipelines.keyframes.learning import Outcome, keyframe_queries
from kinedex.pipelines.keyframes.runs import outcomes_of
from kinedex.pipelines.keyframes.tables import sentence
from kinedex.pipelines.templates.nearest_examples import stored_clips, words_of
from kinedex.storage.store.store import Store

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.archive import Archive

Row = dict[str, Any]


def list_queries(archive: Archive, request: Request) -> Row:
    """Return the learned keyframe queries of a stage."""
    store = archive.store()
    stages = learning_stages(store, "queries")
    if not stages:
        return {"stages": [], "queries": [], "command": command_line("kinedex", "keyframes", "learn", archive.path)}
    stage = request.query_params.get("stage") or stages[0]
    if stage not in stages:
        raise NotFoundError(f"no stage '{stage}' has learned queries; those that have: {', '.join(stages)}")
    outcomes = outcomes_of(store.result("queries", stage=stage))
    taken = {one.subclass for one in outcomes}
    rows = [row for one in outcomes for row in _rows(store, one, keyframe_queries(one, store.feature_set, taken))]
    show = command_line("kinedex", "keyframes", "show", archive.path, "--pipeline", stage)
    return {"stages": stages, "stage": stage, "queries": rows, "command": show}


def _rows(store: Store, outcome: Outcome, queries: Sequence[KeyframeQuery]) -> list[Row]:
    """Return the queries of one class; the scores refer to all of its queries together."""
    return [
        {
            "name": query.name,
            "class": outcome.subclass,
            "origin": outcome.consensus.origin if number == 0 else "run",
            "precision": outcome.precision,
            "recall": outcome.recall,
            "fitness": outcome.consensus.fitness,
            "runs": outcome.runs,
            "clips": len(outcome.clips),
            "text": write_queries([query], store.feature_set),
            "query": model_of([query], store),
            "sentence": sentence(query, store.feature_set),
            "seen": _seen(store, outcome, query),
        }
        for number, query in enumerate(queries)
    ]


def _seen(store: Store, outcome: Outcome, query: KeyframeQuery) -> Row | None:
    """Return the frames of a query's poses in the first training clip that has a hit; None if no clip has one."""
    clips = stored_clips(store, outcome.clips)
    words = words_of(store, sorted({take for take, _, _ in clips}))
    pattern = word_pattern(query, store.feature_set)
    for take, start, stop in clips:
        frames = frames_of_poses(words[take][start:stop], pattern)
        if frames is not None:
            return {"take_id": store.take_ids[take], "take": take, "frames": [start + frame for frame in frames]}
    return None


def frames_of_poses(words: U64, pattern: WordPattern) -> list[int] | None:
    """Return the first frames of a motion that show the keyframes of a query in their order, None where none do.

    Parameters
    ----------
    words : uint64 array (T,)
        The words of the motion.
    pattern : WordPattern
        The keyframes and the gaps between them.
    """
    valid = words != NO_WORD
    seen = [
        valid & ((words & np.uint64(mask)) == np.uint64(value))
        for mask, value in zip(pattern.masks, pattern.values, strict=True)
    ]
    reach = [seen[-1]]  # the frames of each keyframe from which the others can follow, the last keyframe first
    for place in range(len(seen) - 2, -1, -1):
        low, high = pattern.gaps[place]
        before = np.concatenate(([0], np.cumsum(reach[-1])))
        frames = np.arange(len(words))
        first, last = np.minimum(frames + low, len(words)), np.minimum(frames + high + 1, len(words))
        reach.append(seen[place] & (before[last] > before[first]))
    reach.reverse()
    if not reach[0].any():
        return None
    found = [int(np.argmax(reach[0]))]
    for (low, _), here in zip(pattern.gaps, reach[1:], strict=True):
        after = found[-1] + low
        found.append(after + int(np.argmax(here[after:])))
    return found


routes = [get("/api/queries", list_queries)]
