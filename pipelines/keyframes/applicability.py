"""Find templates and queries that do not apply to takes whose bodies lack joints; report them as results and text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, query_share
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.wording import counted, name_list
from kinedex.ops.words import MIN_KNOWN, known_share
from kinedex.storage.snapshot.schemas import result_schema


@dataclass(frozen=True)
class Applicability:
    """The fraction of the entries of one template or query that is known in takes with a given feature mask.

    Attributes
    ----------
    kind : str
        "template" or "query".
    name : str
        The subclass of the template, or the name of the query.
    mask : int
        The mask of the known features, with the bits of a word.
    share : float
        The fraction of its fixed entries that are known.
    """

    kind: str
    name: str
    mask: int
    share: float

    @property
    def applied(self) -> bool:
        """True if the template or query is applied."""
        return self.share >= MIN_KNOWN


def applicability(
    feature_set: FeatureSet,
    masks: Iterable[int],
    templates: Mapping[str, QuantisedTemplate],
    queries: Iterable[KeyframeQuery] = (),
) -> list[Applicability]:
    """Return the known fraction of templates and queries that fix features which some takes do not have.

    Parameters
    ----------
    feature_set : FeatureSet
        The features of the templates and queries.
    masks : iterable of int
        The masks of the known features of takes, with the bits of a word.
    templates : mapping of str to QuantisedTemplate
        The templates, by subclass.
    queries : iterable of KeyframeQuery
        The queries.

    Returns
    -------
    list of Applicability
        Templates and queries of which less than everything is known, sorted by mask, templates first.
    """
    asked = list(dict.fromkeys(queries))
    found = []
    for mask in sorted(set(masks)):
        if mask & feature_set.every_bit == feature_set.every_bit:
            continue
        found += [
            Applicability("template", name, mask, known_share(one.mask.tolist(), mask))
            for name, one in templates.items()
        ]
        found += [Applicability("query", one.name, mask, query_share(one, feature_set, mask)) for one in asked]
    return [one for one in found if one.share < 1]


def remarks_on(found: Sequence[Applicability], known: Mapping[int, int]) -> list[str]:
    """Return sentences on templates and queries that are not applied, or applied only by their known entries.

    Parameters
    ----------
    found : sequence of Applicability
        The applicability for the masks of the takes.
    known : mapping of int to int
        The feature masks of the takes that lack features, by take_id.
    """
    remarks = []
    for kind, plural in (("template", "templates"), ("query", "queries")):
        own = [one for one in found if one.kind == kind]
        refused = [one for one in own if not one.applied]
        partly = [one for one in own if one.applied]
        if refused:
            remarks.append(
                f"{plural} not applied in {_takes(refused, known)}, where less than {MIN_KNOWN:.0%} of their entries "
                f"are known: {_names(refused)}"
            )
        if partly:
            least = min(one.share for one in partly)
            remarks.append(
                f"{plural} applied by their known entries in {_takes(partly, known)} whose bodies lack joints, "
                f"{least:.0%} of them or more: {_names(partly)}"
            )
    return remarks


def _takes(found: Sequence[Applicability], known: Mapping[int, int]) -> str:
    masks = {one.mask for one in found}
    return counted(sum(mask in masks for mask in known.values()), "take")


def _names(found: Sequence[Applicability]) -> str:
    return name_list(list(dict.fromkeys(one.name for one in found)))


def not_applied_table(
    found: Sequence[Applicability], known: Mapping[int, int], names: Mapping[int, str], run: str
) -> pa.Table:
    """Return results of the kind `not_applied`: a row for each take and each template or query not applied to it."""
    by_mask: dict[int, list[Applicability]] = {}
    for one in found:
        if not one.applied:
            by_mask.setdefault(one.mask, []).append(one)
    rows = [
        {"run": run, "take_id": take_id, "take": names[take_id], "kind": one.kind, "name": one.name, "known": one.share}
        for take_id in sorted(known, key=lambda each: names[each])
        for one in by_mask.get(known[take_id], ())
    ]
    return pa.Table.from_pylist(rows, schema=result_schema("not_applied"))


def known_masks(known: Mapping[int, int], take_ids: Iterable[int]) -> dict[int, int]:
    """Return the feature masks of those of the given takes that lack features."""
    return {take_id: known[take_id] for take_id in take_ids if take_id in known} if known else {}
