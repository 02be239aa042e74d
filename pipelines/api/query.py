"""Keyframe queries as Python objects: written in Python or in YAML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_files import build_queries, parse_queries, read_queries
from kinedex.catalog.queries.query_writer import frames_shared, write_queries
from kinedex.ops.errors import KinedexError, ParameterError, did_you_mean
from kinedex.pipelines.api.take import FEATURES

Keyframe = Mapping[str, Any]
Gap = str | Mapping[str, Any] | tuple[int, int | None]


class Query:
    """A keyframe query: poses in their order, and the time that may lie between them.

    Parameters
    ----------
    keyframes : sequence of mapping
        The poses in their order, written as in query files: ``{"on": [features], "off": [features]}``; any other
        feature may be on or off. Features are named or numbered. ``"name"`` is a name for people, and ``"after"`` can
        state the gap before the pose in place of `gaps`.
    gaps : sequence of str, mapping or tuple, optional
        The time between two poses, one gap fewer than poses: a text such as ``"within 2 s"``, ``"0.5 to 2 s"`` or
        ``"exactly 3 frames"``, a mapping as in query files, or ``(low, high)`` in frames with None for no upper bound.
    name : str, optional
        The name of the query, which the hits bear.
    target : str, optional
        The class (subclass) whose motions it finds; the name unless given.
    mirror : {"both", "other"}, optional
        "both" finds the motion of either side as well, "other" that of the other side alone.
    takes : str, optional
        A SQL filter over the columns of takes.
    description : str, optional
        One sentence for people.
    feature_set : str or Path, optional
        The feature set that the features are of.

    Attributes
    ----------
    keyframe_query : KeyframeQuery
        The query as the search uses it.

    Raises
    ------
    ConfigError
        A feature, a gap or a key is wrong; the message names it, what was expected, and the nearest valid name.

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
    """

    def __init__(
        self,
        keyframes: Sequence[Keyframe],
        gaps: Sequence[Gap] = (),
        *,
        name: str = "query",
        target: str | None = None,
        mirror: Literal["both", "other"] | None = None,
        takes: str | None = None,
        description: str = "",
        feature_set: str | Path = FEATURES,
    ) -> None:
        body: dict[str, Any] = {"keyframes": [_plain(keyframe) for keyframe in keyframes]}
        if gaps:
            body["gaps"] = [_written(gap) for gap in gaps]
        optional = {"class": target, "mirror": mirror, "takes": takes, "description": description or None}
        body |= {key: value for key, value in optional.items() if value is not None}
        (made,) = build_queries({name: body}, load_feature_set(feature_set), "kinedex.Query")
        self._set(made, feature_set)

    def _set(self, query: KeyframeQuery, feature_set: str | Path) -> None:
        self.keyframe_query = query
        self.feature_set = load_feature_set(feature_set)

    @classmethod
    def _of(cls, query: KeyframeQuery, feature_set: str | Path) -> Query:
        made = cls.__new__(cls)
        made._set(query, feature_set)
        return made

    @classmethod
    def from_yaml(cls, text: str, name: str | None = None, *, feature_set: str | Path = FEATURES) -> Query:
        """Read a query from YAML.

        Parameters
        ----------
        text : str
            The content of a query file.
        name : str, optional
            The query to return where the text has several.
        feature_set : str or Path, optional
            The feature set that the features are of.

        Returns
        -------
        Query
            The query.

        Raises
        ------
        ConfigError
            The text is wrong; the message names line and key.
        KinedexError
            There is no query of this name, or there are several and none is named.

        Examples
        --------
        >>> kinedex.Query.from_yaml("bent: {keyframes: [{on: [rknee_bent]}]}").name
        'bent'
        """
        found = parse_queries(text, load_feature_set(feature_set))
        return cls._of(_chosen(found, name, "the text"), feature_set)

    @classmethod
    def load(cls, path: str | Path, name: str | None = None, *, feature_set: str | Path = FEATURES) -> Query:
        """Read a query from a query file.

        Parameters
        ----------
        path : str or Path
            A shipped name such as "example", or the path of a YAML file.
        name : str, optional
            The query to return where the file has several.
        feature_set : str or Path, optional
            The feature set that the features are of.

        Returns
        -------
        Query
            The query.

        Raises
        ------
        ConfigError
            The file is wrong; the message names line and key.
        KinedexError
            There is no query of this name, or there are several and none is named.

        Examples
        --------
        >>> kinedex.Query.load("example", "squat").target
        'squat1Reps'
        """
        found = read_queries(path, load_feature_set(feature_set))
        return cls._of(_chosen(found, name, str(path)), feature_set)

    @classmethod
    def load_all(cls, path: str | Path, *, feature_set: str | Path = FEATURES) -> list[Query]:
        """Read all queries of a query file.

        Parameters
        ----------
        path : str or Path
            A shipped name such as "example", or the path of a YAML file.
        feature_set : str or Path, optional
            The feature set that the features are of.

        Returns
        -------
        list of Query
            The queries in the order of the file.

        Raises
        ------
        ConfigError
            The file is wrong; the message names line and key.

        Examples
        --------
        >>> [query.name for query in kinedex.Query.load_all("example")][:2]
        ['squat', 'hands_up']
        """
        return [cls._of(query, feature_set) for query in read_queries(path, load_feature_set(feature_set))]

    @property
    def name(self) -> str:
        """Return the name of the query.

        Returns
        -------
        str
            The name that the hits bear.
        """
        return self.keyframe_query.name

    @property
    def target(self) -> str:
        """Return the class whose motions the query finds.

        Returns
        -------
        str
            The name of a class or subclass.
        """
        return self.keyframe_query.target

    def to_yaml(self) -> str:
        """Return the query as YAML.

        Returns
        -------
        str
            The content of a query file that reads back as the same query.

        Examples
        --------
        >>> query = kinedex.Query([{"on": ["rknee_bent"]}], name="bent")
        >>> kinedex.Query.from_yaml(query.to_yaml()) == query
        True
        """
        return write_queries([self.keyframe_query], self.feature_set)

    def save(self, path: str | Path) -> None:
        """Write the query to a query file.

        Parameters
        ----------
        path : str or Path
            A path ending in .yaml or .yml.

        Raises
        ------
        KinedexError
            The path has another ending, or its folder is missing.

        Examples
        --------
        >>> kinedex.Query([{"on": ["rknee_bent"]}], name="bent").save(folder / "bent.yaml")
        """
        from kinedex.pipelines.report.output import write_page

        if Path(path).suffix.lower() not in (".yaml", ".yml"):
            raise KinedexError(f"{path}: a query file ends in .yaml")
        write_page(self.to_yaml(), Path(path))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Query) and self.keyframe_query == other.keyframe_query

    def __hash__(self) -> int:
        return hash(self.keyframe_query)

    def __repr__(self) -> str:
        count = len(frames_shared(self.keyframe_query, self.feature_set))
        more = len(self.keyframe_query.alternatives)
        return f"Query({self.name!r}, {count} keyframes{f', {more} alternatives' if more else ''})"

    def _repr_html_(self) -> str:
        from kinedex.pipelines.api.html import query_html

        return query_html(self.keyframe_query, self.feature_set)


def keyframe_queries(queries: Query | Iterable[Query]) -> list[KeyframeQuery]:
    """Return queries as the search uses them."""
    return [one.keyframe_query for one in ([queries] if isinstance(queries, Query) else queries)]


def _chosen(found: Sequence[KeyframeQuery], name: str | None, where: str) -> KeyframeQuery:
    names = [query.name for query in found]
    if name is None and len(found) != 1:
        raise KinedexError(f"{where} has {len(found)} queries; pass `name`: {', '.join(names)}")
    if name is not None and name not in names:
        raise KinedexError(f"{where} has no query '{name}'{did_you_mean(name, names)}")
    return found[0] if name is None else found[names.index(name)]


def _plain(keyframe: Keyframe) -> dict[str, Any]:
    if not isinstance(keyframe, Mapping):
        raise ParameterError("keyframes", "mappings such as {'on': ['rknee_bent'], 'off': []}", keyframe)
    return {key: list(value) if isinstance(value, tuple | set) else value for key, value in keyframe.items()}


def _written(gap: Gap) -> Any:
    return {"range": list(gap)} if isinstance(gap, tuple) else gap
