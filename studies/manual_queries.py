"""`python -m studies.manual_queries STORE QUERIES`: print Tables 3.2 and 3.3 of the thesis for manual queries.

QUERIES is a file of keyframe queries, JSON or YAML, whose names are those of Table 3.2. Printed are, for each query, K,
the average of its stiffness vector, the word runs of all its lists, the time of the search, and the share of the frames
that its hits cover, with the printed share beside it. The thesis searched all of HDM05 (210 minutes, 57 classes).

Table 3.3 joins queries: `--output FILE` writes the joined ones for `kinedex search` and `kinedex run retrieval`. The
thesis does not print the gap between two queries; here it is at most two seconds.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.queries.keyframe_query import KeyframeQuery
from kinedex.catalog.queries.query_reader import parse_queries, read_queries
from kinedex.ops.words import TakeWords, cut
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.storage.store.store import Store, open_store

PRINTED_SHARE = {
    "depositFloorR": 6.0,
    "elbowToKnee1RepsLelbowStart": 0.6,
    "grabHighR": 2.9,
    "hopBothLegs1hops": 1.0,
    "jogLeftCircle4StepsRstart": 1.4,
    "kickLFront1Reps": 2.0,
    "lieDownFloor": 2.7,
    "rotateArmsBothBackward1Reps": 1.5,
    "sneak2StepsLStart": 1.5,
    "squat1Reps": 1.0,
    "throwBasketball": 3.0,
}
"""%(D) of Table 3.2 for the classes that have clips in the eleven-class part of HDM05, in per cent."""

JOINED: dict[str, tuple[tuple[str, ...], float]] = {
    "ID58": (("elbowToKnee1RepsLelbowStart", "squat1Reps"), 1.2),
    "ID59": (("jogLeftCircle4StepsRstart", "jogRightCircle4StepsRstart"), 1.3),
    "ID60": (("kickLSide1Reps", "punchLFront1Reps", "punchRSide1Reps"), 1.8),
    "ID61": (("lieDownFloor", "lieDownFloor"), 2.1),
    "ID62": (("rotateArmsBothBackward1Reps", "rotateArmsBothForward1Reps"), 1.0),
    "ID63": (("skier1RepsLstart", "elbowToKnee1RepsLelbowStart"), 0.8),
    "ID64": (("staircaseUp3Rstart", "staircaseDown3Rstart"), 1.0),
    "ID65": (("walkBackwards2StepsRstart", "walkRightCrossFront2Steps"), 1.7),
    "ID66": (("walkOnPlace2StepsLStart", "runOnPlaceStartFloor2StepsRStart"), 1.0),
}
"""The queries that Table 3.3 joins, and its %(D) in per cent."""

WITHIN = "2 s"


def joined(file: Path, queries: Sequence[KeyframeQuery]) -> str:
    """Return a query file with the queries of Table 3.3 whose parts are all in another file."""
    known = {query.name for query in queries}
    lines = [f"# Table 3.3 of the thesis: queries of {file} joined, at most {WITHIN} apart."]
    for name, (parts, _) in JOINED.items():
        if known.issuperset(parts):
            first, *others = [f"{{file: '{file.resolve()}', query: {part}}}" for part in parts]
            steps = [first, *(f"{{then: {one}, within: {WITHIN}}}" for one in others)]
            lines += [f"{name}:", "  sequence:", *(f"    - {step}" for step in steps)]
    return "\n".join(lines) + "\n"


def list_lengths(query: KeyframeQuery, words: TakeWords, feature_set: FeatureSet) -> int:
    """Count the word runs that the lists of all keyframes hold: Σ l_v of Table 3.2."""
    total = 0
    begins = np.zeros(len(words.words), bool)
    begins[words.offsets[:-1]] = True
    for keyframe in query.keyframes:
        chosen = feature_set.sets[keyframe.set]
        own = cut(words.words, chosen.first, chosen.count)
        first = begins | np.concatenate([[True], own[1:] != own[:-1]])
        total += int(np.count_nonzero(first & ((own & np.uint64(keyframe.mask)) == np.uint64(keyframe.value))))
    return total


def line(query: KeyframeQuery, store: Store, words: TakeWords, printed: float | None) -> str:
    """Return one row of the table."""
    spent = []
    for _ in range(5):
        began = time.perf_counter()
        hits = search_store(store, [query], threads=1)
        spent.append(time.perf_counter() - began)
    kept = int(np.sum(hits.column("stop").to_numpy() - hits.column("start").to_numpy())) if hits.num_rows else 0
    stiffness = np.mean([gap.nominal_stiffness for gap in query.gaps])
    lists = list_lengths(query, words, store.feature_set)
    share = f"{kept / len(words.words):.1%}"
    shown = "–" if printed is None else f"{printed:.1f} %"
    return (
        f"| {query.name} | {len(query.keyframes)} | {stiffness:.2f} | {lists:,} | {1000 * min(spent):.1f} | {share} "
        f"| {shown} |"
    )


def main() -> None:
    """Print both tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.manual_queries", description=__doc__)
    parser.add_argument("store", type=Path, help="a store whose index is built")
    parser.add_argument("queries", type=Path, help="a file of keyframe queries")
    parser.add_argument("--all", action="store_true", help="all queries, not only those of the eleven classes")
    parser.add_argument("--output", type=Path, help="write the joined queries into this file")
    given = parser.parse_args()
    store = open_store(given.store)
    queries = read_queries(given.queries, store.feature_set)
    words = store.words()
    text = joined(given.queries, queries)
    if given.output:
        given.output.write_text(text, encoding="utf-8")
    combined = parse_queries(text, store.feature_set, "Table 3.3")
    print(f"{len(words)} takes, {len(words.words) / 1800:.1f} minutes\n")
    for title, chosen in (("Table 3.2", queries), ("Table 3.3", combined)):
        print(f"| {title} | K | average σ | Σ l_v | ms | frames kept | printed (all of HDM05) |\n|---|" + "--:|" * 6)
        for query in chosen:
            printed = PRINTED_SHARE.get(query.name, JOINED.get(query.name, ((), None))[1])
            if given.all or printed is not None:
                print(line(query, store, words, printed), flush=True)
        print()


if __name__ == "__main__":
    main()
