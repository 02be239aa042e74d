"""Define keyframe queries in Python, with the keys of query files as parameters."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Self, TypeVar

import yaml

from kinedex.catalog.configs import Located, config_path, load_yaml, parse_yaml
from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import (
    ANALYSIS_RATE_HZ,
    STRUCTURE,
    QueryReader,
    is_reference,
    referred_path,
    with_switches,
)
from kinedex.ops.errors import ConfigError, KinedexError, did_you_mean

FEATURES = "body40"
"""The default feature set of queries."""

AnyQuery = TypeVar("AnyQuery", bound="Query")

_INNER = (*STRUCTURE, "gaps", "distances", "stiffness", "positions", "mirror")
"""The keys of a query that still have an effect if it is nested in another query."""


class Query:
    """A keyframe query: poses that follow one another in time, or a combination of other queries.

    A query has either `keyframes`, or a `sequence` of queries, or alternatives (`any_of`). The parameters are the keys
    of query files. Times may be given in seconds; they become frames at the rate of the store that is searched.

    Parameters
    ----------
    keyframes : sequence of mapping, optional
        The poses, in order of time. A pose has ``"on"`` and ``"off"``, lists of features by name (``"rknee_bent"``),
        number (20) or label (``"F20"``); any other feature may be on or off. Instead, a pose may have ``"set"`` and
        ``"pattern"``, a text with 0, 1 or * for each feature of a feature set. A pose may also have a ``"name"`` and,
        from the second pose on, ``"after"``, the gap between the previous pose and this one.
    gaps : sequence of str, mapping or tuple, optional
        The gaps between the poses, one fewer than poses, unless the poses have ``"after"``. A gap is a text such as
        ``"within 2 s"``, ``"0.5 s to 2 s"``, ``"at least 1 s"``, ``"0.5 s ± 0.2 s"`` or ``"same frame"``; a mapping
        such as ``{"seconds": 0.5, "tolerance": 0.2}`` or ``{"frames": 12, "stiffness": 0.5}``; or ``(low, high)`` in
        frames, both ends included, with None for no upper bound.
    name : str, optional
        The name of the query, which its hits also have.
    distances : sequence of int, optional
        The distances between the poses in frames, used together with `stiffness` instead of `gaps` (thesis, Section
        3.4).
    stiffness : sequence of float, optional
        A stiffness for each distance, from 0 (any later frame) to 1 (exactly the distance).
    positions : sequence of int, optional
        The template column of each pose, for preselection; by default the columns that match a template best.
    sequence : sequence of Query, mapping or str, optional
        A query, followed by steps ``{"then": query, "within": "2 s"}`` or ``{"then": query, "gap": gap}``. Each query
        is a `Query`, a mapping with the parameters of this constructor, or a reference to a query of a file:
        ``{"file": path, "query": name}``.
    any_of : sequence of Query or mapping, optional
        Alternative queries, given as in `sequence`; a hit of any of them is a hit of this query.
    mirror : {"both", "other"}, optional
        With "both", hits are motions of either side of the body; with "other", only of the mirrored side.
    target : str, optional
        The class or subclass whose motions the query finds (`class` in query files); by default the name.
    takes : str, optional
        A SQL filter over the columns of takes; other takes are not searched.
    margins : (int, int), optional
        The number of frames before and after a hit that a motion may extend; derived from the template by default.
    description : str, optional
        A description in one sentence.
    feature_set : str, Path or FeatureSet, optional
        The features of the query: a shipped set, a file, or an object.

    Raises
    ------
    ConfigError
        If the query is invalid; the message has the parameter, what was expected, and the nearest valid name.

    Examples
    --------
    >>> squat = kinedex.Query(
    ...     [
    ...         {"off": ["rknee_bent", "lknee_bent"]},
    ...         {"on": ["rknee_bent", "lknee_bent", "body_low"]},
    ...         {"off": ["rknee_bent", "lknee_bent"]},
    ...     ],
    ...     gaps=["0.1 to 1.5 s", "0.1 to 1.5 s"],
    ...     name="squat",
    ... )
    >>> store.search(squat).columns[:3]
    ['query', 'take_id', 'take']

    Queries are combined, with the time between them:

    >>> kick = kinedex.Query([{"on": ["rfoot_raised", "rfoot_fast"]}], mirror="both")
    >>> kinedex.Query(sequence=[squat, {"then": kick, "within": "3 s"}], name="squat and kick")
    <Query 'squat and kick' of 2 in sequence>
    """

    def __init__(
        self,
        keyframes: Sequence[Mapping[str, Any]] | None = None,
        gaps: Sequence[str | Mapping[str, Any] | tuple[int, int | None]] | None = None,
        *,
        name: str = "query",
        distances: Sequence[int] | None = None,
        stiffness: Sequence[float] | None = None,
        positions: Sequence[int] | None = None,
        sequence: Sequence[Query | Mapping[str, Any]] | None = None,
        any_of: Sequence[Query | Mapping[str, Any]] | None = None,
        mirror: Literal["both", "other"] | None = None,
        target: str | None = None,
        takes: str | None = None,
        margins: tuple[int, int] | None = None,
        description: str = "",
        feature_set: str | Path | FeatureSet = FEATURES,
    ) -> None:
        words = {
            "description": description or None, "class": target, "takes": takes, "margins": margins,
            "keyframes": keyframes, "gaps": gaps if gaps is None else [_gap(gap) for gap in gaps],
            "distances": distances, "stiffness": stiffness, "positions": positions, "sequence": sequence,
            "any_of": any_of, "mirror": mirror,
        }  # fmt: skip
        self.name = name
        self.feature_set = feature_set if isinstance(feature_set, FeatureSet) else load_feature_set(feature_set)
        self._entry = {word: _plain(value, name) for word, value in words.items() if value is not None}
        self.resolve()

    def resolve(self, feature_set: FeatureSet | None = None, rate_hz: float = ANALYSIS_RATE_HZ) -> KeyframeQuery:
        """Return the query in bits and frames, ready to be searched.

        Parameters
        ----------
        feature_set : FeatureSet, optional
            The features of the store that is searched; by default those of the query.
        rate_hz : float
            The analysis rate of the store, by which seconds become frames.

        Returns
        -------
        KeyframeQuery
            The query as the search uses it.

        Raises
        ------
        ConfigError
            If the feature set lacks a feature of the query, or a gap contains no whole number of frames at this rate.

        Examples
        --------
        >>> kinedex.Query([{"on": [1]}, {"on": [2]}], gaps=["within 2 s"]).resolve(rate_hz=60).gaps[0].high
        120
        """
        located = _WrittenInPython(Path(f"Query '{self.name}'"), {self.name: copy.deepcopy(self._entry)})
        (query,) = QueryReader(located, feature_set or self.feature_set, rate_hz).queries()
        return query

    @property
    def target(self) -> str:
        """Return the class whose motions the query finds.

        Returns
        -------
        str
            The name of a class or subclass.
        """
        target: str = self._entry.get("class", self.name)
        return target

    def to_yaml(self) -> str:
        """Return the query as the text of a query file.

        Returns
        -------
        str
            The text; `from_yaml` reads it as the same query.

        Examples
        --------
        >>> query = kinedex.Query([{"on": ["rknee_bent"]}], name="bent")
        >>> kinedex.Query.from_yaml(query.to_yaml()) == query
        True
        """
        return yaml.dump(
            {self.name: _with_plain_switches(self._entry)},
            Dumper=_Dumper, default_flow_style=None, sort_keys=False, allow_unicode=True, width=110,
        )  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write the query to a query file.

        Parameters
        ----------
        path : str or Path
            A path that ends in .yaml or .yml.

        Raises
        ------
        KinedexError
            If the path has another ending, or cannot be written.

        Examples
        --------
        >>> kinedex.Query([{"on": ["rknee_bent"]}], name="bent").save(folder / "bent.yaml")
        """
        if Path(path).suffix.lower() not in (".yaml", ".yml"):
            raise KinedexError(f"{path}: the name of a query file ends in .yaml")
        try:
            Path(path).write_text(self.to_yaml(), encoding="utf-8")
        except OSError as fault:
            raise KinedexError(f"{path}: cannot be written: {fault.strerror}") from None

    @classmethod
    def from_yaml(cls, text: str, name: str | None = None, *, feature_set: str | Path | FeatureSet = FEATURES) -> Self:
        """Read a query from the text of a query file.

        Parameters
        ----------
        text : str
            The content of a query file.
        name : str, optional
            The query to return where the text has several.
        feature_set : str, Path or FeatureSet, optional
            The features of the query.

        Returns
        -------
        Query
            The query, in which other queries of the file are written out.

        Raises
        ------
        ConfigError
            If the text is invalid; the message names line and key.
        KinedexError
            If there is no query of this name, or there are several and none is named.

        Examples
        --------
        >>> kinedex.Query.from_yaml("bent: {keyframes: [{on: [rknee_bent]}]}").name
        'bent'
        """
        found = cls._read(with_switches(parse_yaml(text, "query")), feature_set)
        return _chosen(found, name, "the text")

    @classmethod
    def load(
        cls, path: str | Path, name: str | None = None, *, feature_set: str | Path | FeatureSet = FEATURES
    ) -> Self:
        """Read a query from a query file.

        Parameters
        ----------
        path : str or Path
            A shipped name such as "example", or the path of a query file.
        name : str, optional
            The query to return where the file has several.
        feature_set : str, Path or FeatureSet, optional
            The features of the query.

        Returns
        -------
        Query
            The query, in which other queries of the file are written out.

        Raises
        ------
        ConfigError
            If the file is invalid; with line and key.
        KinedexError
            If there is no query of this name, or there are several and none is named.

        Examples
        --------
        >>> kinedex.Query.load("example", "squat").target
        'squat1Reps'
        """
        return _chosen(cls.load_all(path, feature_set=feature_set), name, str(path))

    @classmethod
    def load_all(cls, path: str | Path, *, feature_set: str | Path | FeatureSet = FEATURES) -> list[Self]:
        """Read all queries of a query file.

        Parameters
        ----------
        path : str or Path
            A shipped name such as "example", or the path of a query file.
        feature_set : str, Path or FeatureSet, optional
            The features of the queries.

        Returns
        -------
        list of Query
            The queries in the order of the file, without those that are marked `part: true`.

        Raises
        ------
        ConfigError
            If the file is invalid; with line and key.

        Examples
        --------
        >>> [query.name for query in kinedex.Query.load_all("example")][:2]
        ['squat', 'hands_up']
        """
        return cls._read(with_switches(load_yaml(config_path("queries", path))), feature_set)

    @classmethod
    def _read(cls, located: Located, feature_set: str | Path | FeatureSet) -> list[Self]:
        """Return the queries of a file, with references to other queries replaced by the queries themselves."""
        features = feature_set if isinstance(feature_set, FeatureSet) else load_feature_set(feature_set)
        reader = QueryReader(located, features, ANALYSIS_RATE_HZ)
        found = []
        for query in reader.queries():
            words = _written_out(_body(reader, query.name), reader)
            words = {word: value for word, value in words.items() if word not in ("name", "part")}
            found.append(cls(name=query.name, target=words.pop("class", None), feature_set=features, **words))
        return found

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Query) and (self.name, self._entry) == (other.name, other._entry)

    def __hash__(self) -> int:
        return hash((self.name, repr(self._entry)))

    def __repr__(self) -> str:
        kind = next(word for word in STRUCTURE if word in self._entry)
        return f"<Query '{self.name}' of {len(self._entry[kind])} {kind if kind == 'keyframes' else f'in {kind}'}>"


def _chosen(found: list[AnyQuery], name: str | None, where: str) -> AnyQuery:
    """Return the query with the given name; without a name, return the only query."""
    by_name = {query.name: query for query in found}
    if name is None and len(found) != 1:
        raise KinedexError(f"{where} has {len(found)} queries; pass `name`: {', '.join(by_name)}")
    if name is not None and name not in by_name:
        raise KinedexError(f"{where} has no query '{name}'{did_you_mean(name, by_name)}")
    return found[0] if name is None else by_name[name]


class _WrittenInPython(Located):
    """The content of a query that was written in Python, whose errors name parameters instead of lines."""

    def error(self, message: str, *key: str | int) -> ConfigError:
        """Return an error that names the parameter."""
        return super().error(message, *("target" if step == "class" else step for step in key[1:]))


def _gap(gap: str | Mapping[str, Any] | tuple[int, int | None]) -> str | Mapping[str, Any]:
    """Convert a gap to the form that query files use."""
    return {"range": list(gap)} if isinstance(gap, tuple) else gap


def _plain(value: Any, name: str) -> Any:
    """Return a value in the form of a query file: lists for sequences, and entries for nested queries."""
    if isinstance(value, Query):
        if "takes" in value._entry:
            raise KinedexError(
                f"Query '{name}': '{value.name}' has a filter `takes`, which only the outermost query may have"
            )
        return {word: copy.deepcopy(inner) for word, inner in value._entry.items() if word in _INNER}
    if isinstance(value, Mapping):
        return {key: _plain(inner, name) for key, inner in value.items()}
    if isinstance(value, Sequence | set) and not isinstance(value, str):
        return [_plain(inner, name) for inner in value]
    return value


def _body(reader: QueryReader, name: str) -> dict[str, Any]:
    """Return the entry of a query in its file, unchanged."""
    body: dict[str, Any] = reader.located.data[reader.entries[name][0]]
    return body


def _written_out(body: dict[str, Any], reader: QueryReader) -> dict[str, Any]:
    """Return an entry in which references to other queries, in any file, are replaced by the entries themselves."""

    def item(one: Any) -> Any:
        if not isinstance(one, str) and not is_reference(one):
            return _written_out(one, reader)
        name, there = one, reader
        if isinstance(one, dict):
            name, there = one["query"], reader.files[referred_path(reader.located, one["file"]).resolve()]
        named = _written_out(_body(there, name), there)
        return {word: inner for word, inner in named.items() if word in _INNER}

    result = dict(body)
    if "any_of" in body:
        result["any_of"] = [item(one) for one in body["any_of"]]
    if "sequence" in body:
        first, *steps = body["sequence"]
        result["sequence"] = [item(first), *(step | {"then": item(step["then"])} for step in steps)]
    return result


class _Switch(str):
    """The key `on` or `off`, which is written without quotes in a query file."""


class _Dumper(yaml.SafeDumper):
    """Writes YAML in the style of hand-written query files."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return True, so that equal parts are repeated and not written as YAML aliases."""
        return True


_Dumper.add_representer(_Switch, lambda dumper, key: dumper.represent_scalar("tag:yaml.org,2002:bool", str(key)))


def _with_plain_switches(part: Any) -> Any:
    if isinstance(part, dict):
        return {_Switch(key) if key in ("on", "off") else key: _with_plain_switches(one) for key, one in part.items()}
    return [_with_plain_switches(one) for one in part] if isinstance(part, list) else part
