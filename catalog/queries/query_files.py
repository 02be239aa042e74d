"""Read query files: YAML with keyframe queries and combinations of queries, or the JSON form of the papers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from kinedex.catalog.configs import config_path, load_yaml, parse_yaml
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import QueryReader, is_reference, referred_path, with_switches
from kinedex.ops.errors import KinedexError

ANALYSIS_RATE_HZ = 30.0
"""The analysis rate of the papers, by which seconds become frames unless a store gives another."""


def read_queries(
    name_or_path: str | Path, feature_set: FeatureSet, rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Read a file of keyframe queries, YAML or the papers' JSON.

    Parameters
    ----------
    name_or_path : str or Path
        A file, or the name of one in `configs/queries/`.
    feature_set : FeatureSet
        The features of the queries.
    rate_hz : float
        The analysis rate, by which seconds become frames.

    Returns
    -------
    tuple of KeyframeQuery
        The queries of the file, except those that are marked `part: true`.

    Raises
    ------
    ConfigError
        If the file, or one that it refers to, is invalid; the message has the first faulty line, what was expected,
        and the nearest valid name.
    """
    return QueryReader(with_switches(load_yaml(config_path("queries", name_or_path))), feature_set, rate_hz).queries()


def read_query_files(
    names_or_paths: Iterable[str | Path], feature_set: FeatureSet, rate_hz: float = ANALYSIS_RATE_HZ
) -> list[KeyframeQuery]:
    """Read several files of keyframe queries, each like `read_queries`.

    Raises
    ------
    ConfigError
        If a file is invalid.
    KinedexError
        If two queries have the same name.
    """
    queries: dict[str, KeyframeQuery] = {}
    for name in names_or_paths:
        for query in read_queries(name, feature_set, rate_hz):
            if query.name in queries:
                raise KinedexError(
                    f"two keyframe queries are named '{query.name}' (the second one in {name}); give one of them "
                    f"another name, and the class that it is for: `class: {query.target}`"
                )
            queries[query.name] = query
    return list(queries.values())


def parse_queries(
    text: str, feature_set: FeatureSet, path: str | Path = "queries", rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Read queries like `read_queries`, from a text; errors name `path`, and references are relative to it."""
    return QueryReader(with_switches(parse_yaml(text, path)), feature_set, rate_hz).queries()


def part_names(name_or_path: str | Path) -> tuple[str, ...]:
    """Return the names of the queries of a file that are parts (`part: true`), which `read_queries` does not return."""
    data = load_yaml(config_path("queries", name_or_path)).data
    items = data.items() if isinstance(data, dict) else ((None, body) for body in data)
    return tuple(str(body.get("name", key)) for key, body in items if isinstance(body, dict) and body.get("part"))


def query_file_paths(names_or_paths: Iterable[str | Path]) -> list[Path]:
    """Return the paths of query files and of all files that they refer to, which a digest of queries must cover.

    Raises
    ------
    ConfigError
        If a file is missing or is not YAML.
    """
    found: dict[Path, Path] = {}
    waiting = [config_path("queries", name) for name in names_or_paths]
    while waiting:
        path = waiting.pop(0)
        if path.resolve() not in found:
            found[path.resolve()] = path
            located = load_yaml(path)
            waiting += [referred_path(located, name, *key) for name, *key in references(located.data)]
    return list(found.values())


def references(part: Any, *key: str | int) -> Iterator[tuple[Any, ...]]:
    """Yield the file of every reference in a part of the content of a query file, followed by its key."""
    if is_reference(part) and isinstance(part.get("file"), str):
        yield (part["file"], *key, "file")
    elif isinstance(part, dict | list):
        for step, inner in part.items() if isinstance(part, dict) else enumerate(part):
            yield from references(inner, *key, step)
