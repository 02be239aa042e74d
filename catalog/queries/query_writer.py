"""Write keyframe queries as YAML that is read back as the same queries."""

from __future__ import annotations

from collections.abc import Iterable

from kinedex.catalog.configs import scalar
from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, Gap, Keyframe, KeyframeQuery, features_of, pattern_of
from kinedex.ops.search.gaps import UNBOUNDED


def write_queries(queries: Iterable[KeyframeQuery], feature_set: FeatureSet) -> str:
    """Write queries as YAML that `read_queries` reads as the same queries.

    Keyframes are written by feature names; parts in different sets that share a frame become one keyframe again.

    Parameters
    ----------
    queries : iterable of KeyframeQuery
        Queries over the sets of the feature set, with different names.
    feature_set : FeatureSet
        The features whose names are written.

    Returns
    -------
    str
        The text of a query file.
    """
    return "\n".join(_written(query, feature_set) for query in queries) or "{}\n"


def _written(query: KeyframeQuery, feature_set: FeatureSet) -> str:
    """Return the entry of one query."""
    lines = [f"{scalar(query.name)}:"]
    if query.description:
        lines.append(f"  description: {scalar(query.description)}")
    if query.target != query.name:
        lines.append(f"  class: {scalar(query.target)}")
    if query.takes is not None:
        lines.append(f"  takes: {scalar(query.takes)}")
    if query.margins is not None:
        lines.append(f"  margins: [{query.margins[0]}, {query.margins[1]}]")
    if not query.alternatives:
        lines += [f"  {line}" for line in _chain(query, feature_set)]
    else:
        lines.append("  any_of:")
        for chain in query.chains:
            inner = _chain(chain, feature_set)
            lines += [f"    - {inner[0]}", *(f"      {line}" for line in inner[1:])]
    return "\n".join(lines) + "\n"


def _chain(query: KeyframeQuery, feature_set: FeatureSet) -> list[str]:
    """Return the lines of the keyframes, gaps and positions of a query without its alternatives."""
    groups = pose_groups(query, feature_set)
    lines = ["keyframes:"]
    lines += [f"  - {_keyframe_text([query.keyframes[i] for i in group], feature_set)}" for group in groups]
    if len(groups) > 1:
        lines.append("gaps:")
        lines += [f"  - {_gap_text(query.gaps[group[0] - 1])}" for group in groups[1:]]
    if query.positions is not None:
        lines.append(f"positions: [{', '.join(str(query.positions[group[0]]) for group in groups)}]")
    return lines


def pose_groups(query: KeyframeQuery, feature_set: FeatureSet) -> list[list[int]]:
    """Return the indices of the keyframes of each pose; a pose over several feature sets has several keyframes."""
    order = list(feature_set.sets)
    groups = [[0]]
    for i, (before, here) in enumerate(zip(query.keyframes, query.keyframes[1:], strict=False), start=1):
        joined = (
            query.gaps[i - 1] == SAME_FRAME
            and order.index(before.set) < order.index(here.set)
            and before.mask != 0 != here.mask
            and before.name == here.name
            and (query.positions is None or query.positions[i - 1] == query.positions[i])
        )
        if joined:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _keyframe_text(parts: list[Keyframe], feature_set: FeatureSet) -> str:
    """Return one pose as query files write it; its features may belong to several sets."""
    named = f"name: {scalar(parts[0].name)}, " if parts[0].name else ""
    if not parts[0].mask:
        return f'{{{named}set: {scalar(parts[0].set)}, pattern: "{pattern_of(parts[0], feature_set)}"}}'
    sides = list(zip(*(features_of(part, feature_set) for part in parts), strict=True))
    on, off = ([name for names in side for name in names] for side in sides)
    return f"{{{named}{pose_text(on, off, feature_set)}}}"


def pose_text(on: Iterable[str], off: Iterable[str], feature_set: FeatureSet) -> str:
    """Return the features of a pose as query files write them; a pose without features is a pattern of wildcards."""
    names = {"on": list(map(scalar, on)), "off": list(map(scalar, off))}
    if not any(names.values()):
        anything = next(iter(feature_set.sets.values()))
        return f'set: {anything.name}, pattern: "{"*" * anything.count}"'
    return ", ".join(f"{word}: [{', '.join(those)}]" for word, those in names.items() if those)


def _gap_text(gap: Gap) -> str:
    if gap.distance is not None and gap.stiffness is not None:
        return f"{{frames: {gap.distance}, stiffness: {gap.stiffness!r}}}"
    return f"{{range: [{gap.low}, {'null' if gap.high == UNBOUNDED else gap.high}]}}"
