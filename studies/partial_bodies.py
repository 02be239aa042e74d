"""`python -m studies.partial_bodies STORE SOURCE`: judge annotations of bodies that lack joints.

STORE is that of `kinedex run hdm05`, SOURCE the folder that it was made from. The takes of actor mm are read again, and
joints are removed from them as if the files did not hold them. They are annotated with the store's templates, learned
from whole bodies of other actors, and compared with the ground truth. Three tables are printed: F of both methods for
each set of joints; the same for other ways of treating what is unknown; and F of each class.

The ways: `false` takes unknown features for 0, as words have them; `all entries` divides the cost of a column by all
its fixed entries, not by those that are known; `strict queries` matches a template nowhere where one of its query's
entries is unknown, instead of asking for the others. Nothing is chosen by the results but the rule that is documented.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinedex.catalog.classes import load_classes
from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.catalog.queries.keyframe_query import KeyframeQuery, query_share
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate
from kinedex.ops.words import TakeWords, bits, known_bits
from kinedex.pipelines.annotation.annotation_setup import learned_queries
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.annotation.template_methods import ThesisMethod
from kinedex.pipelines.evaluation.ground_truth import place_ground_truth
from kinedex.pipelines.ingestion.analysis import analyse, known_features
from kinedex.pipelines.templates.template_learning import read_templates
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.formats.motion.reader import Body, ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.store.store import Store, open_store

DELTA, TAU = 0.05, 0.13
ACTOR, TRAINING = "mm", "actor IN ('bd', 'bk', 'dg') AND class IS NOT NULL"

_LEFT_ARM, _RIGHT_ARM = ("lelbow", "lwrist", "lfingers"), ("relbow", "rwrist", "rfingers")
_LEFT_LEG, _RIGHT_LEG = ("lknee", "lankle", "ltoes"), ("rknee", "rankle", "rtoes")
_TRUNK = ("belly", "chest", "neck", "head", "headtop", "lclavicle", "lshoulder", "rclavicle", "rshoulder")

VARIANTS: Mapping[str, tuple[str, ...]] = {
    "whole body": (),
    "no head": ("head", "headtop"),
    "no toes": ("ltoes", "rtoes"),
    "no hands": ("lfingers", "rfingers"),
    "no left arm": _LEFT_ARM,
    "no right arm": _RIGHT_ARM,
    "no left leg": _LEFT_LEG,
    "no right leg": _RIGHT_LEG,
    "no arms": (*_LEFT_ARM, *_RIGHT_ARM),
    "no legs": (*_LEFT_LEG, *_RIGHT_LEG),
    "lower body removed": ("lhip", "rhip", *_LEFT_LEG, *_RIGHT_LEG),
    "upper body removed": (*_TRUNK, *_LEFT_ARM, *_RIGHT_ARM),
}
"""Name → the joints that are removed."""

Truth = Mapping[tuple[int, str], list[tuple[int, int]]]
"""Manual segments, frames [start, stop), by the index of a take and a class."""


@dataclass(frozen=True)
class Material:
    """The takes of the actor as bodies, with ground truth, and the annotator of each method."""

    store: Store
    bodies: tuple[Body, ...]
    truth: Truth
    annotators: Mapping[str, Annotator]


def read_material(store: Store, source: Path) -> Material:
    """Read the takes of the actor and the ground truth, and make the annotators."""
    joints = store.feature_set.joints
    mappings = load_mappings("auto", joints)
    takes = store.takes(f"actor = '{ACTOR}' AND class IS NULL").sort("name")
    bodies = [
        read_body(source / row["source"], source / row["skeleton_source"], mappings, joints, ReadSettings())
        for row in takes.iter_rows(named=True)
    ]
    templates = read_templates(store, "hdm05/learn_templates", "soft")
    classes = load_classes("hdm05-11", {one.subclass for one in templates})
    label_files = [read_labels(file) for file in sorted(source.rglob("ground_truth.csv"))]
    placed = place_ground_truth(label_files, takes, store.takes()["name"], classes, "ignore")
    index = {name: place for place, name in enumerate(takes["name"])}
    truth: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for one in placed.segments:
        truth.setdefault((index[one.take], one.label), []).append((one.start, one.stop))
    learned = learned_queries(store, "hdm05/learn_keyframes")
    clips = [store.words(store.takes(TRAINING)["take_id"].to_list()).words]
    annotators = {
        name: make_annotator(
            store.feature_set, templates, classes, DELTA, TAU, queries, method=annotation_method(method),
            clips=lambda: clips,
        )
        for name, method, queries in (
            ("thesis", "thesis", ()), ("thesis, learned queries", "thesis", learned), ("best", "best", ()),
            ("best, learned queries", "best", learned),
        )
    }  # fmt: skip
    return Material(store, tuple(bodies), truth, annotators)


def words_without(material: Material, removed: Sequence[str]) -> TakeWords:
    """Return the words of the takes as if their files did not hold some joints."""
    feature_set = load_feature_set(material.store.feature_set.name)
    words, masks = [], []
    for body in material.bodies:
        positions = body.positions.copy()
        positions[[feature_set.joints.index(joint) for joint in removed]] = np.nan
        without = replace(body, positions=positions, unknown=tuple(removed))
        words.append(analyse(without, feature_set, material.store.rate_hz)[2])
        masks.append(known_features(feature_set, without))
    offsets = np.cumsum([0, *map(len, words)]).astype(np.int64)
    known = np.array(masks, np.uint64) if removed else None
    return TakeWords(np.arange(len(words)), offsets, np.concatenate(words), known)


def all_entries(annotator: Annotator, known: int) -> Annotator | None:
    """Return an annotator whose costs are shares of all fixed entries: unknown ones ask for the 0 that words have."""
    restricted, chosen = annotator.restricted(known)
    if restricted is None:
        return None
    own = [annotator.templates[s] for s in chosen.tolist()]
    filled = tuple(QuantisedTemplate(one.mask, one.value & np.uint64(known), one.feature_weights) for one in own)
    return replace(restricted, templates=filled, method=_thesis(restricted, filled))


def strict(annotator: Annotator, known: int) -> Annotator | None:
    """Return an annotator with the queries alone that are known whole; templates that lose all of theirs go."""
    restricted, chosen = annotator.restricted(known)
    if restricted is None:
        return None

    def whole(query: KeyframeQuery) -> bool:
        return all(query_share(chain, annotator.feature_set, known) == 1 for chain in query.chains)

    queries = [tuple(filter(whole, annotator.queries[s])) for s in chosen.tolist()]
    kept = [place for place, own in enumerate(queries) if own]
    templates = tuple(restricted.templates[place] for place in kept)
    some = replace(
        restricted,
        subclasses=tuple(restricted.subclasses[place] for place in kept),
        class_index=restricted.class_index[kept],
        templates=templates,
        queries=tuple(queries[place] for place in kept),
    )
    return replace(some, method=_thesis(some, templates)) if kept else None


def _thesis(annotator: Annotator, templates: tuple[QuantisedTemplate, ...]) -> ThesisMethod:
    return ThesisMethod(templates, annotator.class_index, np.full(len(annotator.classes), TAU))


def counts_of(annotator: Annotator | None, words: TakeWords, truth: Truth, label: str | None = None) -> Counts:
    """Count the agreement of labels and manual segments over all takes, and over all classes or one."""
    automatic: dict[tuple[int, str], list[tuple[int, int]]] = {}
    if annotator is not None:
        for one in annotate_words(annotator, words):
            for segment in one.segments:
                name = annotator.classes[segment.class_index]
                automatic.setdefault((one.take_id, name), []).append((segment.start, segment.stop))
    keys = sorted(key for key in {*automatic, *truth} if label in (None, key[1]))
    return pooled(compare(automatic.get(key, []), truth.get(key, [])) for key in keys)


def f_of(counts: Counts) -> str:
    """Return F (frames) and F (segments) as cells of a table."""
    return " | ".join("–" if np.isnan(value) else f"{value:.2f}" for value in (counts.f1, counts.f2))


def applied(annotator: Annotator, mask: int) -> tuple[int, int]:
    """Return how many templates and how many queries are applied to takes with a mask."""
    restricted, _ = annotator.restricted(mask)
    if restricted is None:
        return 0, 0
    return len(restricted.templates), sum(map(len, restricted.queries))


def differing(words: TakeWords, whole: TakeWords, feature_set: FeatureSet) -> str:
    """Return the share of the known features' bits that differ from those of whole bodies, and the worst feature's."""
    count = len(feature_set.features)
    changed = (bits(words.words, count) != bits(whole.words, count)).mean(axis=0)[known_bits(words.masks[0], count)]
    return f"{changed.mean():.1%} | {changed.max():.1%}"


def print_variants(material: Material) -> None:
    """Print F of each method for each set of joints, and how many templates are applied."""
    names = list(material.annotators)
    head = " | ".join(f"{name}: F (frames) | F (segments)" for name in names)
    print(f"| | known features | bits that differ | at most | templates | queries | {head} |")
    print("|---|" + "--:|" * (5 + 2 * len(names)))
    whole = words_without(material, ())
    with_queries = material.annotators["thesis, learned queries"]
    for variant, removed in VARIANTS.items():
        words = words_without(material, removed)
        mask = words.masks[0] & material.store.feature_set.every_bit
        templates, queries = applied(with_queries, mask)
        cells = " | ".join(f_of(counts_of(one, words, material.truth)) for one in material.annotators.values())
        changed = differing(words, whole, material.store.feature_set)
        print(f"| {variant} | {mask.bit_count()} | {changed} | {templates} | {queries} | {cells} |", flush=True)


def print_ways(material: Material) -> None:
    """Print F of the thesis's method for other ways of treating what is unknown."""
    plain, asked = material.annotators["thesis"], material.annotators["thesis, learned queries"]
    names = ("as it is", "false", "all entries", "with queries, as it is", "strict queries")
    head = " | ".join(f"{name}: F (frames) | F (segments)" for name in names)
    print(f"| | {head} |\n|---|" + "--:|" * (2 * len(names)))
    for variant, removed in VARIANTS.items():
        words = words_without(material, removed)
        mask, blind = words.masks[0] & material.store.feature_set.every_bit, replace(words, known=None)
        counts = (
            counts_of(plain, words, material.truth),
            counts_of(plain, blind, material.truth),
            counts_of(all_entries(plain, mask), blind, material.truth),
            counts_of(asked, words, material.truth),
            counts_of(strict(asked, mask), blind, material.truth),
        )
        print(f"| {variant} | {' | '.join(map(f_of, counts))} |", flush=True)


def print_classes(material: Material, method: str) -> None:
    """Print F (frames) of one method for each class and set of joints; a class that is not applied has no number."""
    annotator = material.annotators[method]
    labels = [annotator.classes[index] for index in annotator.class_index.tolist()]
    print(f"| {method} | {' | '.join(VARIANTS)} |\n|---|" + "--:|" * len(VARIANTS))
    rows: dict[str, list[str]] = {label: [] for label in labels}
    for removed in VARIANTS.values():
        words = words_without(material, removed)
        for place, label in enumerate(labels):
            one = restricted_template(annotator.templates[place], words.masks[0])
            counts = counts_of(annotator, words, material.truth, label)
            rows[label].append("not applied" if one is None else "–" if np.isnan(counts.f1) else f"{counts.f1:.2f}")
    for label, cells in rows.items():
        print(f"| {label} | {' | '.join(cells)} |")


def main() -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.partial_bodies", description=__doc__)
    parser.add_argument("store", type=Path, help="store of `kinedex run hdm05`")
    parser.add_argument("source", type=Path, help="the folder that it was made from")
    given = parser.parse_args()
    material = read_material(open_store(given.store), given.source)
    print_variants(material)
    print()
    print_ways(material)
    for method in ("thesis", "best"):
        print()
        print_classes(material, method)


if __name__ == "__main__":
    main()
