"""Rank by templates and by their mirror images together, for motions of either side of the body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.mirror import mirrored
from kinedex.ops.errors import KinedexError
from kinedex.ops.ranking.hit_selection import KEYS
from kinedex.ops.templates.mirror import rearrange
from kinedex.pipelines.ranking.ranked_hits import Hit, RankedTemplate, Ranking
from kinedex.pipelines.ranking.ranking import rank_takes
from kinedex.storage.store.store import Store


def mirrored_template(one: RankedTemplate, feature_set: FeatureSet) -> RankedTemplate:
    """Return a template, with its queries, for the same motion on the other side of the body.

    Raises
    ------
    KinedexError
        The feature set defines no pairs of left and right.
    """
    if not feature_set.mirror:
        raise KinedexError(
            f"feature set '{feature_set.name}' does not define which features are left and right, so a template "
            "cannot be mirrored; add `mirror: [[1, 2], …]`, pairs of feature numbers, to its file"
        )
    order, weights = feature_set.mirror_order, one.template.feature_weights
    template = replace(
        one.template,
        mask=rearrange(one.template.mask, order),
        value=rearrange(one.template.value, order),
        feature_weights=None if weights is None else weights[order],
    )
    return RankedTemplate(one.name, template, tuple(mirrored(query, feature_set) for query in one.queries))


def rank_both_sides(
    store: Store,
    templates: Sequence[RankedTemplate],
    tau: float,
    top: int | None = None,
    where: str | None = None,
    workers: int | None = None,
) -> list[Ranking]:
    """Rank the takes of a store by templates and by their mirror images, with one list of hits for each template.

    If a hit of the template and one of its image overlap, the better one is kept, and the template's own if they are
    equal. The best 3 hits are the first of the best 10, as in `rank_takes`.

    Parameters
    ----------
    store : Store
        The store to search.
    templates : sequence of RankedTemplate
        The templates, each with its keyframe queries.
    tau, top, where, workers : float, int, str, int
        As in `rank_takes`.

    Returns
    -------
    list of Ranking
        One for each template, in their order. Hits of an image are `mirrored`; frames searched and computed are the
        means of both.

    Raises
    ------
    KinedexError
        The feature set defines no pairs of left and right, or `rank_takes` raises an error.
    """
    found: dict[int, Ranking] = {}
    # a motion of both sides of the body is in both lists, and counts once
    asked = None if top is None else top + top // 2
    while len(found) < len(templates):
        left = [place for place in range(len(templates)) if place not in found]
        pairs = [one for place in left for one in (templates[place], _image(store, templates[place]))]
        ranked = rank_takes(store, pairs, tau, asked, where, workers)
        for i, place in enumerate(left):
            merged, whole = _merged(ranked[2 * i], ranked[2 * i + 1], asked)
            if top is None or whole or len(merged.hits) >= top:
                found[place] = replace(merged, hits=merged.hits[:top])
        asked = None if asked is None else 2 * asked
    return [found[place] for place in range(len(templates))]


def _image(store: Store, one: RankedTemplate) -> RankedTemplate:
    return mirrored_template(one, store.feature_set)


def _merged(own: Ranking, image: Ranking, asked: int | None) -> tuple[Ranking, bool]:
    """Return the hits that are certain to be the best of both lists, and whether these are all hits."""
    entries = [(_key(hit, False), hit) for hit in own.hits]
    entries += [(_key(hit, True), replace(hit, mirrored=True)) for hit in image.hits]
    # A list that was limited to this number of hits may have more beyond its last one.
    ends = [_key(one.hits[-1], side) for one, side in ((own, False), (image, True)) if len(one.hits) == asked]
    kept: list[Hit] = []
    in_take: dict[int, list[Hit]] = {}
    for key, hit in sorted(entries, key=lambda entry: entry[0]):
        if ends and key > min(ends):
            break
        others = in_take.setdefault(hit.take_id, [])
        if not any(hit.start < other.stop and other.start < hit.stop for other in others):
            others.append(hit)
            kept.append(hit)
    ranking = replace(
        own,
        hits=tuple(kept),
        searched=(own.searched + image.searched) // 2,
        computed=(own.computed + image.computed) // 2,
        bounded=own.bounded or image.bounded,
        ranking=own.ranking + image.ranking,
    )
    return ranking, not ends


def _key(hit: Hit, side: bool) -> tuple[int, str, int, bool]:
    """Return the sort key of a hit: cost, take and stop, with the template's own hits before those of its image."""
    return round(hit.cost * KEYS), hit.take, hit.stop, side
