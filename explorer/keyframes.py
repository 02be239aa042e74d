"""Search by keyframes: a few poses, given by features that are on or off, with times between them, or as YAML.

`POST /api/ask/keyframes` {text | query, where?, filters?, limit? ≤ 500} with the text of a query file, or a query
 {name, poses: [{on: [feature], off: [feature]}], gaps: [{low, high: seconds or null}]}
→ {text, query or null, hits: [hit], total, takes, share, seconds, remarks, version, fault: null, command, python}.
 `query` is null where the text holds more than a sequence of poses. A text that cannot be read is answered with
 `fault`: {message, line}, and no hits, so that the page can mark the line while somebody types.

`POST /api/ask/propose` {take_id | take, start, stop, keyframes?, name?} → {text, query}: keyframes of an example.

The learned keyframe queries of a store, as poses with the frames of a training clip that show them.

`GET /api/queries?stage=` → {stages: [name], stage, queries: [{name, class, origin, precision, recall, fitness, runs,
 clips, text, query: {name, poses: [{on, off}], gaps: [{low, high}]} or null, sentence, seen}]}. `seen` is null, or
 {take_id, take, frames: [frame of each pose]}: the first training clip in which the query finds something.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator
from starlette.requests import Request

from kinedex.catalog.configs import parse_yaml, scalar
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, WordPattern, features_of, word_pattern
from kinedex.catalog.queries.query_reader import parse_queries, references
from kinedex.catalog.queries.query_writer import pose_groups, pose_text, write_queries
from kinedex.explorer.answers import NotFoundError, command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.hits import ChosenHit, Limit, shown_hits, take_condition
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import Selection
from kinedex.explorer.templates import learning_stages
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.ops.intervals import in_seconds, nearest_frame
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.ops.words import NO_WORD, U64
from kinedex.pipelines.keyframes.learning_runs import outcomes_of
from kinedex.pipelines.keyframes.proposed_query import propose_query
from kinedex.pipelines.keyframes.query_learning import Outcome, keyframe_queries
from kinedex.pipelines.keyframes.store_search import search_remarks, search_store
from kinedex.pipelines.keyframes.stored_queries import query_sentence
from kinedex.pipelines.templates.stored_clips import clip_intervals, words_of
from kinedex.storage.snapshot.schemas import hits_of
from kinedex.storage.store.store import Store

MAX_TEXT = 100_000
MAX_POSES = 20


Row = dict[str, Any]


class PoseEntry(RequestBody):
    """A pose: the features that are on, and the features that are off; all others are wildcards."""

    on: tuple[str, ...] = ()
    off: tuple[str, ...] = ()


class GapEntry(RequestBody):
    """The time from one pose to the next, in seconds; without `high` any time from `low` on."""

    low: Annotated[float, Field(ge=0, le=86_400)]
    high: Annotated[float | None, Field(ge=0, le=86_400)] = None


class QueryEntry(RequestBody):
    """A sequence of poses."""

    name: Annotated[str, Field(min_length=1, max_length=100)] = "query"
    poses: Annotated[tuple[PoseEntry, ...], Field(min_length=1, max_length=MAX_POSES)]
    gaps: tuple[GapEntry, ...] = ()

    @model_validator(mode="after")
    def _matches(self) -> QueryEntry:
        if len(self.gaps) != len(self.poses) - 1:
            raise ValueError(f"{len(self.poses)} poses have {len(self.poses) - 1} gaps, got {len(self.gaps)}")
        return self


class KeyframesRequest(Selection):
    """A request to search for keyframes, given as text or as poses."""

    text: Annotated[str | None, Field(max_length=MAX_TEXT)] = None
    query: QueryEntry | None = None
    limit: Limit = 100

    @model_validator(mode="after")
    def _one(self) -> KeyframesRequest:
        if (self.text is None) == (self.query is None):
            raise ValueError("give either `text` or `query`")
        return self


class ProposalRequest(ChosenHit):
    """A request to propose keyframes for an example."""

    keyframes: Annotated[int, Field(ge=1, le=MAX_POSES)] = 3
    name: Annotated[str, Field(min_length=1, max_length=100)] = "proposed"


def find_keyframes(archive: Archive, asked: KeyframesRequest, _request: Request) -> dict[str, Any]:
    """Return the first hits of keyframe queries, and the number of all."""
    begin = time.perf_counter()
    store = archive.store()
    text = asked.text if asked.query is None else written(asked.query, store)
    assert text is not None
    try:
        queries = read_text(text, store)
    except ConfigError as fault:
        place = "" if fault.key is None else f"{fault.key}: "
        return {"text": text, "query": None, "fault": {"message": f"{place}{fault.reason}", "line": fault.line},
                "hits": [], "total": 0, "takes": 0, "share": 0.0, "seconds": 0.0, "remarks": []}  # fmt: skip
    condition = take_condition(store, asked)
    table = search_store(store, queries, condition)
    starts, stops = (table.column(name).to_numpy() for name in ("start", "stop"))
    frames = sum(store.take_frames.values())
    where = [] if condition is None else ["--where", condition]
    more = "" if condition is None else f", where={condition!r}"
    return {
        "text": text,
        "query": model_of(queries, store),
        "fault": None,
        "hits": shown_hits(store, hits_of(table.slice(0, asked.limit), "query")),
        "total": table.num_rows,
        "takes": len(np.unique(table.column("take_id").to_numpy())),
        "share": float(np.sum(stops - starts)) / max(frames, 1),
        "seconds": time.perf_counter() - begin,
        "remarks": search_remarks(store, queries, condition),
        "version": store.manifest.version,
        "command": command_line("kinedex", "search", archive.path, f"{queries[0].name}.yaml", *where),
        "python": python_lines(archive.path, f"store.search({f'{queries[0].name}.yaml'!r}{more})"),
    }


def read_text(text: str, store: Store) -> tuple[KeyframeQuery, ...]:
    """Return the queries in the text of a query file, which may refer to shipped files only.

    Raises
    ------
    ConfigError
        The text is invalid (the message names the line), has no query, or refers to a file.
    """
    located = parse_yaml(text, "the text")
    for name, *key in references(located.data):
        if "/" in name or "\\" in name or "." in name:
            raise located.error(f"refers to the file '{name}'; in the explorer a query may refer to shipped ones", *key)
    queries = parse_queries(text, store.feature_set, "the text", store.rate_hz)
    if not queries:
        raise ConfigError("the text", "holds no query to search", line=1)
    return queries


def written(query: QueryEntry, store: Store) -> str:
    """Return a sequence of poses as the text of a query file."""
    known = {feature.name for feature in store.feature_set.features}
    lines = [f"{scalar(query.name)}:", "  keyframes:"]
    for number, pose in enumerate(query.poses):
        if unknown := [name for name in (*pose.on, *pose.off) if name not in known]:
            raise KinedexError(f"pose {number + 1}: no feature is named '{unknown[0]}'")
        after = f"after: {_gap(query.gaps[number - 1], store.rate_hz)}, " if number else ""
        lines.append(f"    - {{{after}{pose_text(pose.on, pose.off, store.feature_set)}}}")
    return "\n".join(lines) + "\n"


def _gap(gap: GapEntry, rate_hz: float) -> str:
    """Return a gap in whole frames, as query files write it."""
    low = nearest_frame(gap.low, rate_hz)
    return (
        f"at least {low} frames"
        if gap.high is None
        else f"{low} to {max(low, nearest_frame(gap.high, rate_hz))} frames"
    )


def model_of(queries: Sequence[KeyframeQuery], store: Store) -> dict[str, Any] | None:
    """Return queries as a sequence of poses; None if a sequence of poses cannot represent them."""
    (first, *others) = queries
    if others or first.alternatives or first.takes is not None:
        return None
    poses, gaps = [], []
    for group in pose_groups(first, store.feature_set):
        on: list[str] = []
        off: list[str] = []
        for place in group:
            for names, more in zip((on, off), features_of(first.keyframes[place], store.feature_set), strict=True):
                names += more
        poses.append({"on": on, "off": off})
        if group[0]:
            gap = first.gaps[group[0] - 1]
            high = None if gap.high >= UNBOUNDED else in_seconds(gap.high, store.rate_hz)
            gaps.append({"low": in_seconds(gap.low, store.rate_hz), "high": high})
    return {"name": first.name, "poses": poses, "gaps": gaps}


def propose(archive: Archive, asked: ProposalRequest, _request: Request) -> dict[str, Any]:
    """Return keyframes of an example, as text and as poses."""
    store = archive.store()
    take, start, stop = asked.hit(store).interval
    text = propose_query(store, take, start, stop, name=asked.name, keyframes=asked.keyframes)
    words: list[str | Path] = ["kinedex", "query", "from-clip", archive.path, take, str(start), str(stop)]
    return {
        "text": text,
        "query": model_of(read_text(text, store), store),
        "command": command_line(*words, "--keyframes", str(asked.keyframes)),
    }


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
            "sentence": query_sentence(query, store.feature_set),
            "seen": _seen(store, outcome, query),
        }
        for number, query in enumerate(queries)
    ]


def _seen(store: Store, outcome: Outcome, query: KeyframeQuery) -> Row | None:
    """Return the frames of a query's poses in the first training clip that has a hit; None if no clip has one."""
    clips = clip_intervals(store, outcome.clips)
    words = words_of(store, sorted({take for take, _, _ in clips}))
    pattern = word_pattern(query, store.feature_set)
    for take, start, stop in clips:
        frames = frames_of_poses(words[take][start:stop], pattern)
        if frames is not None:
            return {"take_id": store.take_ids[take], "take": take, "frames": [start + frame for frame in frames]}
    return None


def frames_of_poses(words: U64, pattern: WordPattern) -> list[int] | None:
    """Return the first frames of a motion that show the keyframes of a query in order; None if there are none.

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


routes = [
    post("/api/ask/keyframes", find_keyframes, KeyframesRequest),
    post("/api/ask/propose", propose, ProposalRequest),
    get("/api/queries", list_queries),
]
