"""Read query files: convert their entries to keyframe queries, and resolve references to other files."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, config_path, load_yaml, parse_yaml
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_entries import Chain, ChainEntry, read_chain, read_gap
from kinedex.catalog.queries.keyframe_query import Gap, KeyframeQuery, mirrored
from kinedex.ops.errors import ConfigError, KinedexError, did_you_mean
from kinedex.ops.local_paths import refuse_addresses

MAX_CHAINS = 64
"""Maximum number of chains of keyframes into which one query may expand: alternatives within sequences multiply."""

STRUCTURE = ("keyframes", "sequence", "any_of")
"""The keys that define the structure of a query, which has exactly one of them."""

_OUTERMOST_ONLY = ("name", "description", "class", "takes", "margins", "part")
"""The keys that are allowed only in the outermost query, since they have no effect in a nested one."""

_Within = tuple[tuple[Path, str], ...]
"""The queries that are being read, from the outermost to the innermost: file and name of each."""

ANALYSIS_RATE_HZ = 30.0
"""The analysis rate of the papers, used to convert seconds to frames unless a store has another rate."""


class QueryEntry(ChainEntry):
    """The entry of one query in a query file."""

    name: str | None = None
    description: str = ""
    target: str | None = Field(default=None, alias="class")
    takes: str | None = Field(default=None, min_length=1)
    margins: tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=0)]] | None = None
    part: bool = False
    mirror: Literal["both", "other"] | None = None
    sequence: list[Any] | None = Field(default=None, min_length=1)
    any_of: list[Any] | None = Field(default=None, min_length=1)


class StepEntry(BaseModel):
    """A step of a sequence after its first query: the next query, and the time between the two."""

    model_config = ConfigDict(extra="forbid")
    then: Any = None
    within: str | None = None
    gap: Any = None


class ReferenceEntry(BaseModel):
    """A reference to a query of another file: a path relative to this file or a shipped name, and the query's name."""

    model_config = ConfigDict(extra="forbid")
    file: str
    query: str


def is_reference(item: Any) -> bool:
    """Return whether an item of a sequence or of alternatives refers to a query of another file."""
    return isinstance(item, dict) and ("file" in item or "query" in item)


def referred_path(located: Located, name: str, *key: str | int) -> Path:
    """Return the path of another query file, which a query file names at a key.

    Raises
    ------
    ConfigError
        If there is no such file; the message has the line of the reference.
    """
    try:
        refuse_addresses(name)
    except KinedexError as fault:
        raise located.error(str(fault), *key) from None
    path = Path(name).expanduser()
    if "/" in name or path.suffix in (".yaml", ".yml", ".json"):
        name = str(located.path.parent / path)
    try:
        return config_path("queries", name)
    except ConfigError as fault:
        raise located.error(f"{fault.path}: {fault.reason}", *key) from None


class QueryReader:
    """Reads the queries of one file, and of the files that it refers to.

    Parameters
    ----------
    located : Located
        The content of the file, `with_switches`.
    feature_set : FeatureSet
        The features of the queries.
    rate_hz : float
        The analysis rate, by which seconds become frames.
    files : dict of Path to QueryReader, optional
        The readers of files that were opened before, by absolute path; this reader is added to the dict.
    """

    def __init__(
        self, located: Located, feature_set: FeatureSet, rate_hz: float, files: dict[Path, QueryReader] | None = None
    ) -> None:
        self.located, self.feature_set, self.rate_hz = located, feature_set, rate_hz
        self.path = located.path.resolve()
        self.files = {} if files is None else files
        self.files[self.path] = self
        self.entries: dict[str, tuple[str | int, QueryEntry]] = {}
        self.chains_read: dict[str, list[Chain]] = {}
        self._read_entries()

    def _read_entries(self) -> None:
        """Check the entry of every query of the file, without resolving its references."""
        items: list[tuple[str | int, Any]]
        if isinstance(self.located.data, list):
            items = list(enumerate(self.located.data))
        else:
            items = list(self.located.mapping().items())
        for key, body in items:
            entry = self.entry(body, key)
            name = _query_name(self.located, key, entry)
            if name in self.entries:
                raise self.located.error(f"a second query is named '{name}'", key)
            self.entries[name] = (key, entry)

    def queries(self) -> tuple[KeyframeQuery, ...]:
        """Return the queries of the file, except those that are marked `part: true`."""
        found = {name: self.query(name) for name in self.entries}
        return tuple(query for name, query in found.items() if not self.entries[name][1].part)

    def entry(self, body: Any, *key: str | int) -> QueryEntry:
        """Check the entry of one query, without resolving its references."""
        if not isinstance(body, dict):
            raise self.located.error("a query is a mapping with `keyframes` and `gaps`", *key)
        entry = self.located.model(QueryEntry, *key, data=body)
        kinds = [kind for kind in STRUCTURE if getattr(entry, kind) is not None]
        if len(kinds) != 1:
            got = " and ".join(kinds) or "none of them"
            raise self.located.error(f"a query has one of keyframes, sequence or any_of, got {got}", *key)
        for word in ("gaps", "distances", "stiffness", "positions"):
            if entry.keyframes is None and getattr(entry, word) is not None:
                raise self.located.error(f"`{word}` goes with `keyframes`", *key, word)
        return entry

    def query(self, name: str) -> KeyframeQuery:
        """Return the query with a name."""
        key, entry = self.entries[name]
        first, *others = self.chains_of(name, ())
        made = KeyframeQuery(
            name, entry.target or name, first.keyframes, first.gaps, first.positions, entry.description, entry.takes,
            entry.margins, takes_at="" if entry.takes is None else self._where(key, "takes"),
        )  # fmt: skip
        more = tuple(
            replace(made, keyframes=other.keyframes, gaps=other.gaps, positions=other.positions) for other in others
        )
        return replace(made, alternatives=more)

    def _where(self, *key: str | int) -> str:
        """Return the file and the line of a key."""
        line = self.located.line(*key)
        return str(self.located.path) if line is None else f"{self.located.path}:{line}"

    def chains_of(self, name: str, within: _Within) -> list[Chain]:
        """Return the chains of keyframes into which a named query expands."""
        if name not in self.chains_read:
            key, entry = self.entries[name]
            self.chains_read[name] = self._chains(entry, (*within, (self.path, name)), key)
        return self.chains_read[name]

    def _chains(self, entry: QueryEntry, within: _Within, *key: str | int) -> list[Chain]:
        """Return the chains of keyframes into which an entry expands."""
        if entry.keyframes is not None:
            found = [read_chain(self.located, entry, self.feature_set, self.rate_hz, *key)]
        elif entry.any_of is not None:
            found = []
            for i, item in enumerate(entry.any_of):
                found += self._item(item, within, *key, "any_of", i)
        else:
            found = self._sequence(entry.sequence or [], within, *key, "sequence")
        found = self._mirror(found, entry.mirror)
        if len(found) > MAX_CHAINS:
            raise self.located.error(
                f"stands for {len(found)} chains of keyframes, as alternatives multiply; at most {MAX_CHAINS}: "
                "write several queries instead",
                *key,
            )
        return found

    def _item(self, item: Any, within: _Within, *key: str | int) -> list[Chain]:
        """Return the chains of a query inside another one, given as a name, a reference, or an entry."""
        if isinstance(item, str):
            return self._named(self, item, within, *key)
        if is_reference(item):
            return self._in_other_file(item, within, *key)
        if not isinstance(item, dict):
            raise self.located.error(f"must be the name of a query or a query, got {item!r}", *key)
        for word in _OUTERMOST_ONLY:
            if word in item:
                raise self.located.error(
                    f"`{word}` belongs to a query of its own, not to one inside another", *key, word
                )
        return self._chains(self.entry(item, *key), within, *key)

    def _in_other_file(self, item: dict[Any, Any], within: _Within, *key: str | int) -> list[Chain]:
        """Return the chains of a query of another file."""
        reference = self.located.model(ReferenceEntry, *key, data=item)
        path = referred_path(self.located, reference.file, *key, "file")
        other = self.files.get(path.resolve())
        if other is None:
            other = QueryReader(with_switches(load_yaml(path)), self.feature_set, self.rate_hz, self.files)
        return self._named(other, reference.query, within, *key, "query")

    def _named(self, other: QueryReader, name: str, within: _Within, *key: str | int) -> list[Chain]:
        """Return the chains of a query that this file refers to by name, in this file or another one."""
        if name not in other.entries:
            there = "" if other is self else f" in {other.located.path}"
            raise self.located.error(f"no query is named '{name}'{there}{did_you_mean(name, other.entries)}", *key)
        if (other.path, name) in within:
            circle = " → ".join([*(one for _, one in within), name])
            raise self.located.error(f"'{name}' is made of itself: {circle}", *key)
        if other.entries[name][1].takes is not None:
            raise self.located.error(f"'{name}' has a filter `takes`, which only the outermost query may have", *key)
        return other.chains_of(name, within)

    def _sequence(self, items: list[Any], within: _Within, *key: str | int) -> list[Chain]:
        """Join queries in sequence, with a gap between the last keyframe of each query and the first of the next."""
        found: list[Chain] = []
        for i, item in enumerate(items):
            if i == 0:
                found = self._item(item, within, *key, 0)
                continue
            if not isinstance(item, dict) or "then" not in item:
                raise self.located.error(
                    "a step gives the query that follows as `then`, and the time after which it does as `within` or "
                    "`gap`",
                    *key,
                    i,
                )
            step = self.located.model(StepEntry, *key, i, data=item)
            gap = self._gap(step, *key, i)
            later = self._item(step.then, within, *key, i, "then")
            found = [_joined(one, gap, other) for one in found for other in later]
            if len(found) > MAX_CHAINS:
                break
        return found

    def _gap(self, step: StepEntry, *key: str | int) -> Gap:
        """Return the gap before a step of a sequence."""
        if (step.within is None) == (step.gap is None):
            raise self.located.error("a step has either `within: 2 s` or `gap` as between keyframes", *key)
        if step.within is not None:
            return read_gap(self.located, f"within {step.within}", self.rate_hz, *key, "within")
        return read_gap(self.located, step.gap, self.rate_hz, *key, "gap")

    def _mirror(self, chains: list[Chain], which: str | None) -> list[Chain]:
        """Return the chains of the other side of the body, or of both sides."""
        if which is None:
            return chains
        swapped = [mirrored(KeyframeQuery("", "", chain.keyframes, chain.gaps), self.feature_set) for chain in chains]
        other = [replace(chain, keyframes=one.keyframes) for chain, one in zip(chains, swapped, strict=True)]
        return other if which == "other" else list(dict.fromkeys([*chains, *other]))


def _joined(one: Chain, gap: Gap, other: Chain) -> Chain:
    return Chain(one.keyframes + other.keyframes, (*one.gaps, gap, *other.gaps))


def with_switches(located: Located) -> Located:
    """Convert the keys `on` and `off`, which YAML 1.1 reads as true and false, back to texts."""

    def word(step: Any) -> Any:
        return "on" if step is True else "off" if step is False else step

    def renamed(part: Any) -> Any:
        if isinstance(part, dict):
            return {word(key): renamed(inner) for key, inner in part.items()}
        return [renamed(inner) for inner in part] if isinstance(part, list) else part

    lines = {tuple(word(step) for step in key): line for key, line in located.lines.items()}
    return Located(located.path, renamed(located.data), lines)


def _query_name(located: Located, key: str | int, entry: QueryEntry) -> str:
    if isinstance(located.data, list):
        if entry.name is None:
            raise located.error("this key is missing", key, "name")
        return entry.name
    if not isinstance(key, str):
        raise located.error("the name of a query must be a text; put it in quotes", key)
    if entry.name not in (None, key):
        raise located.error(f"the query is already named '{key}'", key, "name")
    return key


def read_queries(
    name_or_path: str | Path, feature_set: FeatureSet, rate_hz: float = ANALYSIS_RATE_HZ
) -> tuple[KeyframeQuery, ...]:
    """Read a file of keyframe queries, either YAML or JSON in the papers' form.

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
    """Read queries from a text like `read_queries`; errors name `path`, and references are relative to `path`."""
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
    """Yield the file of every reference in a part of a query file's content, followed by the key of the reference."""
    if is_reference(part) and isinstance(part.get("file"), str):
        yield (part["file"], *key, "file")
    elif isinstance(part, dict | list):
        for step, inner in part.items() if isinstance(part, dict) else enumerate(part):
            yield from references(inner, *key, step)
