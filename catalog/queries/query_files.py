"""Query files: keyframe queries as YAML that people write, and queries built from queries; the papers' JSON too."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml, parse_yaml
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.mirror import mirrored
from kinedex.catalog.queries.gap_entries import read_gap
from kinedex.catalog.queries.keyframe_entries import Chain, ChainEntry, read_chain, refuse_unknown_keys
from kinedex.catalog.queries.keyframe_query import Gap, KeyframeQuery
from kinedex.ops.errors import KinedexError, did_you_mean

ANALYSIS_RATE_HZ = 30.0
MOST_CHAINS = 64
"""The most chains of keyframes that one query may stand for: alternatives within sequences multiply."""


def read_queries(
    name_or_path: str | Path, feature_set: FeatureSet, rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Read a file of keyframe queries, YAML or the papers' JSON.

    Parameters
    ----------
    name_or_path: a file, or the name of one in `configs/queries/`.
    feature_set: the features that the file speaks of.
    rate_hz: the analysis rate, by which seconds become frames.

    Raises
    ------
    ConfigError: the first fault, with its line, what was expected, and the nearest valid name.
    """
    return _queries(load_yaml(config_path("queries", name_or_path)), feature_set, rate_hz)


def read_query_files(
    names_or_paths: Iterable[str | Path], feature_set: FeatureSet, rate_hz: float = ANALYSIS_RATE_HZ
) -> list[KeyframeQuery]:
    """The queries of several files, as `read_queries` reads each.

    Raises
    ------
    ConfigError: the first fault of a file. KinedexError: two queries of the same name.
    """
    queries: dict[str, KeyframeQuery] = {}
    for name in names_or_paths:
        for query in read_queries(name, feature_set, rate_hz):
            if query.name in queries:
                raise KinedexError(
                    f"two keyframe queries are named '{query.name}' (the second one in {name}); give one of them "
                    f"another name and say what it is for: `class: {query.target}`"
                )
            queries[query.name] = query
    return list(queries.values())


def parse_queries(
    text: str, feature_set: FeatureSet, path: str | Path = "queries", rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Like `read_queries`, for text that is already read; `path` is what errors name."""
    return _queries(parse_yaml(text, path), feature_set, rate_hz)


def build_queries(
    content: Mapping[str, Any], feature_set: FeatureSet, path: str | Path, rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Build queries from mappings that say the same as a query file.

    Parameters
    ----------
    content : mapping
        The name of each query, and its keys as in a query file.
    feature_set : FeatureSet
        The features that the queries refer to.
    path : str or Path
        The name that errors give to the content.
    rate_hz : float
        The analysis rate, by which seconds become frames.

    Returns
    -------
    tuple of KeyframeQuery
        The queries that are no parts.

    Raises
    ------
    ConfigError
        At the first fault, with its key, what was expected, and the nearest valid name.
    """
    return _queries(Located(Path(path), dict(content)), feature_set, rate_hz)


def part_names(name_or_path: str | Path) -> tuple[str, ...]:
    """The queries of a file that are parts (`part: true`): there for others, and not among those that are read."""
    data = load_yaml(config_path("queries", name_or_path)).data
    items = data.items() if isinstance(data, dict) else ((None, body) for body in data)
    return tuple(str(body.get("name", key)) for key, body in items if isinstance(body, dict) and body.get("part"))


class _QueryEntry(ChainEntry):
    name: str | None = None
    description: str = ""
    target: str | None = Field(default=None, alias="class")
    takes: str | None = Field(default=None, min_length=1)
    margins: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] | None = None
    part: bool = False
    mirror: Literal["both", "other"] | None = None
    sequence: list[Any] | None = Field(default=None, min_length=1)
    any_of: list[Any] | None = Field(default=None, min_length=1)


class _StepEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    then: Any = None
    within: str | None = None
    gap: Any = None


_ONLY_NAMED = ("name", "description", "class", "takes", "margins", "part")
"""What a query says of itself that is lost where it stands inside another one."""


def _queries(located: Located, feature_set: FeatureSet, rate_hz: float) -> tuple[KeyframeQuery, ...]:
    return _Reader(_with_switches(located), feature_set, rate_hz).queries()


class _Reader:
    """Reads the queries of one file, each with what it is built from."""

    def __init__(self, located: Located, feature_set: FeatureSet, rate_hz: float) -> None:
        self.located, self.feature_set, self.rate_hz = located, feature_set, rate_hz
        self.entries: dict[str, tuple[str | int, _QueryEntry]] = {}
        self.read: dict[str, list[Chain]] = {}

    def queries(self) -> tuple[KeyframeQuery, ...]:
        located = self.located
        items: list[tuple[str | int, Any]]
        if isinstance(located.data, list):
            items = list(enumerate(located.data))
        else:
            items = list(located.mapping().items())
        for key, body in items:
            entry = self.entry(body, key)
            name = _query_name(located, key, entry)
            if name in self.entries:
                raise located.error(f"a second query is named '{name}'", key)
            self.entries[name] = (key, entry)
        found = {name: self.query(name) for name in self.entries}
        return tuple(query for name, query in found.items() if not self.entries[name][1].part)

    def entry(self, body: Any, *key: str | int) -> _QueryEntry:
        """One query as it is written, checked but for what it refers to."""
        if not isinstance(body, dict):
            raise self.located.error("a query is a mapping with `keyframes` and `gaps`", *key)
        refuse_unknown_keys(self.located, body, _QueryEntry, *key)
        entry = self.located.model(_QueryEntry, *key, data=body)
        kinds = [kind for kind in ("keyframes", "sequence", "any_of") if getattr(entry, kind) is not None]
        if len(kinds) != 1:
            got = " and ".join(kinds) or "none of them"
            raise self.located.error(f"a query has one of keyframes, sequence or any_of, got {got}", *key)
        for word in ("gaps", "distances", "stiffness", "positions"):
            if entry.keyframes is None and getattr(entry, word) is not None:
                raise self.located.error(f"`{word}` goes with `keyframes`", *key, word)
        return entry

    def query(self, name: str) -> KeyframeQuery:
        key, entry = self.entries[name]
        first, *others = self.chains_of(name, ())
        made = KeyframeQuery(
            name, entry.target or name, first.keyframes, first.gaps, first.positions, entry.description, entry.takes,
            entry.margins, takes_at="" if entry.takes is None else self.where(key, "takes"),
        )  # fmt: skip
        more = tuple(
            replace(made, keyframes=other.keyframes, gaps=other.gaps, positions=other.positions) for other in others
        )
        return replace(made, alternatives=more)

    def where(self, *key: str | int) -> str:
        """The file and the line of a key."""
        line = self.located.line(*key)
        return str(self.located.path) if line is None else f"{self.located.path}:{line}"

    def chains_of(self, name: str, within: tuple[str, ...]) -> list[Chain]:
        """The chains that a named query stands for; `within` are the queries that are being read."""
        if name not in self.read:
            key, entry = self.entries[name]
            self.read[name] = self.chains(entry, (*within, name), key)
        return self.read[name]

    def chains(self, entry: _QueryEntry, within: tuple[str, ...], *key: str | int) -> list[Chain]:
        if entry.keyframes is not None:
            found = [read_chain(self.located, entry, self.feature_set, self.rate_hz, *key)]
        elif entry.any_of is not None:
            found = []
            for i, item in enumerate(entry.any_of):
                found += self.refer(item, within, *key, "any_of", i)
        else:
            found = self.sequence(entry.sequence or [], within, *key, "sequence")
        found = self.mirror(found, entry.mirror)
        if len(found) > MOST_CHAINS:
            raise self.located.error(
                f"stands for {len(found)} chains of keyframes, as alternatives multiply; at most {MOST_CHAINS}: "
                "write several queries instead",
                *key,
            )
        return found

    def refer(self, item: Any, within: tuple[str, ...], *key: str | int) -> list[Chain]:
        """The chains of a query that stands in another one: a name, or a query itself."""
        if isinstance(item, str):
            if item not in self.entries:
                raise self.located.error(f"no query is named '{item}'{did_you_mean(item, self.entries)}", *key)
            if item in within:
                raise self.located.error(f"'{item}' is made of itself: {' → '.join((*within, item))}", *key)
            if self.entries[item][1].takes is not None:
                raise self.located.error(
                    f"'{item}' has a filter `takes`, which only the outermost query may have", *key
                )
            return self.chains_of(item, within)
        if not isinstance(item, dict):
            raise self.located.error(f"must be the name of a query or a query, got {item!r}", *key)
        for word in _ONLY_NAMED:
            if word in item:
                raise self.located.error(
                    f"`{word}` belongs to a query of its own, not to one inside another", *key, word
                )
        return self.chains(self.entry(item, *key), within, *key)

    def sequence(self, items: list[Any], within: tuple[str, ...], *key: str | int) -> list[Chain]:
        """Queries one after the other: the gap lies between the last keyframe of one and the first of the next."""
        found: list[Chain] = []
        for i, item in enumerate(items):
            if i == 0:
                found = self.refer(item, within, *key, 0)
                continue
            if not isinstance(item, dict) or "then" not in item:
                raise self.located.error("say `then` which query follows, and `within` or `gap` how soon", *key, i)
            refuse_unknown_keys(self.located, item, _StepEntry, *key, i)
            step = self.located.model(_StepEntry, *key, i, data=item)
            gap = self.gap(step, *key, i)
            later = self.refer(step.then, within, *key, i, "then")
            found = [_joined(one, gap, other) for one in found for other in later]
            if len(found) > MOST_CHAINS:
                break
        return found

    def gap(self, step: _StepEntry, *key: str | int) -> Gap:
        if (step.within is None) == (step.gap is None):
            raise self.located.error("say how soon: either `within: 2 s` or `gap` as between keyframes", *key)
        if step.within is not None:
            return read_gap(self.located, f"within {step.within}", self.rate_hz, *key, "within")
        return read_gap(self.located, step.gap, self.rate_hz, *key, "gap")

    def mirror(self, chains: list[Chain], which: str | None) -> list[Chain]:
        if which is None:
            return chains
        other = [self.mirrored(chain) for chain in chains]
        return other if which == "other" else list(dict.fromkeys([*chains, *other]))

    def mirrored(self, chain: Chain) -> Chain:
        swapped = mirrored(KeyframeQuery("", "", chain.keyframes, chain.gaps), self.feature_set)
        return replace(chain, keyframes=swapped.keyframes)


def _joined(one: Chain, gap: Gap, other: Chain) -> Chain:
    return Chain(one.keyframes + other.keyframes, (*one.gaps, gap, *other.gaps))


def _with_switches(located: Located) -> Located:
    """YAML 1.1 takes the keys `on` and `off` for true and false; here they are words."""

    def word(step: Any) -> Any:
        return "on" if step is True else "off" if step is False else step

    def renamed(part: Any) -> Any:
        if isinstance(part, dict):
            return {word(key): renamed(inner) for key, inner in part.items()}
        return [renamed(inner) for inner in part] if isinstance(part, list) else part

    lines = {tuple(word(step) for step in key): line for key, line in located.lines.items()}
    return Located(located.path, renamed(located.data), lines)


def _query_name(located: Located, key: str | int, entry: _QueryEntry) -> str:
    if isinstance(located.data, list):
        if entry.name is None:
            raise located.error("this key is missing", key, "name")
        return entry.name
    if not isinstance(key, str):
        raise located.error("the name of a query must be a text; put it in quotes", key)
    if entry.name not in (None, key):
        raise located.error(f"the query is already named '{key}'", key, "name")
    return key
