"""Search by keyframes: a few poses by features that are on or off, the time between them, and the same as YAML.

`POST /api/ask/keyframes` {text | query, where?, filters?, limit? ≤ 500} with the text of a query file, or a query
 {name, poses: [{on: [feature], off: [feature]}], gaps: [{low, high: seconds or null}]}
→ {text, query or null, hits: [hit], total, takes, share, seconds, remarks, version, fault: null, command, python}.
 `query` is null where the text holds more than a sequence of poses. A text that cannot be read is answered with
 `fault`: {message, line}, and no hits, so that the page can mark the line while somebody types.

`POST /api/ask/propose` {take_id | take, start, stop, keyframes?, name?} → {text, query}: keyframes of an example.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from kinedex.catalog.configs import parse_yaml, scalar
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, features_of
from kinedex.catalog.queries.query_files import parse_queries, references
from kinedex.catalog.queries.query_writer import pose_groups
from kinedex.explorer.addresses import Question, post
from kinedex.explorer.hits import ChosenHit, Limit, take_condition
from kinedex.explorer.same import command_line, python_lines
from kinedex.explorer.selections import Selection
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.pipelines.search.query_proposal import propose_query
from kinedex.pipelines.search.search import search_remarks, search_store

if TYPE_CHECKING:
    import pyarrow as pa
    from starlette.requests import Request

    from kinedex.explorer.archive import Archive
    from kinedex.storage.store.store import Store

MOST_TEXT = 100_000
MOST_POSES = 20


class PoseEntry(Question):
    """A pose: the features that are on, and the features that are off; all others are wildcards."""

    on: tuple[str, ...] = ()
    off: tuple[str, ...] = ()


class GapEntry(Question):
    """The time from one pose to the next, in seconds; without `high` any time from `low` on."""

    low: Annotated[float, Field(ge=0, le=86_400)]
    high: Annotated[float | None, Field(ge=0, le=86_400)] = None


class QueryEntry(Question):
    """A sequence of poses."""

    name: Annotated[str, Field(min_length=1, max_length=100)] = "query"
    poses: Annotated[tuple[PoseEntry, ...], Field(min_length=1, max_length=MOST_POSES)]
    gaps: tuple[GapEntry, ...] = ()

    @model_validator(mode="after")
    def _matches(self) -> QueryEntry:
        if len(self.gaps) != len(self.poses) - 1:
            raise ValueError(f"{len(self.poses)} poses have {len(self.poses) - 1} gaps, got {len(self.gaps)}")
        return self


class KeyframesQuestion(Selection):
    """A request to search for keyframes, given as text or as poses."""

    text: Annotated[str | None, Field(max_length=MOST_TEXT)] = None
    query: QueryEntry | None = None
    limit: Limit = 100

    @model_validator(mode="after")
    def _one(self) -> KeyframesQuestion:
        if (self.text is None) == (self.query is None):
            raise ValueError("give either `text` or `query`")
        return self


class ProposalQuestion(ChosenHit):
    """A request to propose keyframes for an example."""

    keyframes: Annotated[int, Field(ge=1, le=MOST_POSES)] = 3
    name: Annotated[str, Field(min_length=1, max_length=100)] = "proposed"


def find_keyframes(archive: Archive, asked: KeyframesQuestion, _request: Request) -> dict[str, Any]:
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
        "hits": _hits(table.slice(0, asked.limit)),
        "total": table.num_rows,
        "takes": len(np.unique(table.column("take_id").to_numpy())),
        "share": float(np.sum(stops - starts)) / max(frames, 1),
        "seconds": time.perf_counter() - begin,
        "remarks": search_remarks(store, queries, condition),
        "version": store.manifest.version,
        "command": command_line("kinedex", "search", archive.path, f"{queries[0].name}.yaml", *where),
        "python": python_lines(archive.path, f"store.search({f'{queries[0].name}.yaml'!r}{more})"),
    }


def _hits(table: pa.Table) -> list[dict[str, Any]]:
    return [
        {
            "take_id": row["take_id"],
            "take": row["take"],
            "start": row["start"],
            "stop": row["stop"],
            "cost": None,
            "mirrored": False,
            "name": row["query"],
        }
        for row in table.to_pylist()
    ]


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
        lines.append(f"    - {{{after}{_switches(pose, store)}}}")
    return "\n".join(lines) + "\n"


def _gap(gap: GapEntry, rate_hz: float) -> str:
    """Return a gap in whole frames, as query files write it."""
    low = round(gap.low * rate_hz)
    return f"at least {low} frames" if gap.high is None else f"{low} to {max(low, round(gap.high * rate_hz))} frames"


def _switches(pose: PoseEntry, store: Store) -> str:
    names = (("on", pose.on), ("off", pose.off))
    shown = [f"{word}: [{', '.join(scalar(name) for name in those)}]" for word, those in names if those]
    if shown:
        return ", ".join(shown)
    anything = next(iter(store.feature_set.sets.values()))
    return f'set: {anything.name}, pattern: "{"*" * anything.count}"'


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
            high = None if gap.high >= UNBOUNDED else gap.high / store.rate_hz
            gaps.append({"low": gap.low / store.rate_hz, "high": high})
    return {"name": first.name, "poses": poses, "gaps": gaps}


def propose(archive: Archive, asked: ProposalQuestion, _request: Request) -> dict[str, Any]:
    """Return keyframes of an example, as text and as poses."""
    store = archive.store()
    names = {take_id: name for name, take_id in store.take_ids.items()}
    one = asked.interval(store)
    take = names[one.take_id]
    text = propose_query(store, take, one.start, one.stop, name=asked.name, keyframes=asked.keyframes)
    words: list[str | Path] = ["kinedex", "query", "from-clip", archive.path, take, str(one.start), str(one.stop)]
    return {
        "text": text,
        "query": model_of(read_text(text, store), store),
        "command": command_line(*words, "--keyframes", str(asked.keyframes)),
    }


routes = [
    post("/api/ask/keyframes", find_keyframes, KeyframesQuestion),
    post("/api/ask/propose", propose, ProposalQuestion),
]
