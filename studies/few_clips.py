"""`python -m studies.few_clips STORE`: judge labels that were learned from few example clips.

The store is that of `kinedex run annotate` with ground truth. A number of clips is drawn of every class, of two people
at least if it is above one; a class that has fewer gives all. All takes with ground truth are labelled by templates of
these clips alone. This is repeated with other draws. Parameters are those of the pipeline `annotate`; nothing is chosen
by the results.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from kinedex.catalog.classes import load_classes
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.templates.template_learning import learn_templates, training_clips
from kinedex.storage.store.store import Store, open_store

METHODS = ("thesis", "best")
DELTA, TAU = 0.05, 0.13

Truth = Mapping[tuple[int, str], list[tuple[int, int]]]
"""Manual segments, frames [start, stop), of a take and a class."""


def draw(clips: pl.DataFrame, count: int | None, seed: int) -> list[str]:
    """Draw example clips of every class, of two people at least where the class has two.

    Parameters
    ----------
    clips : polars.DataFrame
        Clips with the columns name, class, actor.
    count : int or None
        The number of clips of a class; a class with fewer gives all, as does every class for None.
    seed : int
        The seed of the draw.

    Returns
    -------
    list of str
        The names of the clips, class by class.
    """
    generator = np.random.default_rng(seed)
    chosen: list[str] = []
    for _, group in clips.sort("class", "name").group_by("class", maintain_order=True):
        order = generator.permutation(group.height)
        people = group["actor"].to_numpy()[order]
        if count and 1 < count < len(order) and len(set(people[:count])) == 1 < len(set(people)):
            # all are of one person: replace the last one by the first clip of another person
            order[count - 1] = order[int(np.argmax(people != people[0]))]
        chosen += group["name"].gather(order[:count]).to_list()
    return chosen


def annotators(store: Store, names: Sequence[str], classes: str, executor: Executor) -> dict[str, Annotator]:
    """Return an annotator of each method with templates of the named clips; `classes` is a file, or `own`."""
    takes = store.takes().filter(pl.col("name").is_in(names))
    features = len(store.feature_set.features)
    clips = training_clips(store, takes)
    templates = [one for task in learn_templates(clips, ["soft"], features, executor) for one in task]
    known = load_classes(classes, {one.subclass for one in templates})
    words = [store.words(takes["take_id"].to_list()).words]
    return {
        method: make_annotator(
            store.feature_set, templates, known, DELTA, TAU, method=annotation_method(method), clips=lambda: words
        )
        for method in METHODS
    }


def truth_of(store: Store) -> Truth:
    """Return the manual segments of the store's evaluation.

    Raises
    ------
    SystemExit
        The store has none.
    """
    rows = pl.DataFrame(store.result("ground_truth")).select("take_id", "class", "start", "stop").unique()
    if not rows.height:
        raise SystemExit(f"{store.path} has no ground truth: kinedex run annotate --store {store.path} --set source=…")
    found: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for take_id, label, start, stop in rows.sort("take_id", "start").iter_rows():
        found.setdefault((take_id, label), []).append((start, stop))
    return found


def counts(annotator: Annotator, words: TakeWords, truth: Truth) -> Counts:
    """Count the agreement of labels and manual segments over all takes and classes."""
    automatic: dict[tuple[int, str], list[tuple[int, int]]] = {}
    for one in annotate_words(annotator, words):
        for segment in one.segments:
            label = annotator.classes[segment.class_index]
            automatic.setdefault((one.take_id, label), []).append((segment.start, segment.stop))
    return pooled(compare(automatic.get(key, []), truth.get(key, [])) for key in sorted({*automatic, *truth}))


def line(name: str, clips: Sequence[int], found: Mapping[str, Sequence[Counts]]) -> str:
    """Return a row of the Markdown table: clips drawn, then mean ± standard deviation over the draws."""
    cells = []
    for method in METHODS:
        for values in ([one.f1 for one in found[method]], [one.f2 for one in found[method]]):
            spread = f" ± {np.std(values, ddof=1):.2f}" if len(values) > 1 else ""
            cells.append(f"{np.mean(values):.2f}{spread}")
    return f"| {name} | {np.mean(clips):.0f} | {' | '.join(cells)} |"


def main() -> None:
    """Draw, learn, label and print the table as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.few_clips", description=__doc__)
    parser.add_argument("store", type=Path, help="store of `kinedex run annotate` with ground truth")
    parser.add_argument("--counts", type=int, nargs="+", default=[1, 2, 3, 5, 10], help="clips of each class")
    parser.add_argument("--draws", type=int, default=10, help="draws for each count")
    parser.add_argument("--classes", default="own", help="the classes that the ground truth speaks of")
    given = parser.parse_args()
    store = open_store(given.store)
    clips = store.takes("class IS NOT NULL")
    truth = truth_of(store)
    words = store.words(sorted({take_id for take_id, _ in truth}))
    executor = make_executor("serial", None)
    people = clips["actor"].n_unique()
    print(f"{clips['class'].n_unique()} classes; {clips.height} clips of {people} people; {given.draws} draws")
    print(
        "\n| clips of a class | in all | thesis: F (frames) | F (segments) | best: F (frames) | F (segments) |\n"
        "|---|--:|---|---|---|---|"
    )
    for count in (*given.counts, None):
        sizes: list[int] = []
        found: dict[str, list[Counts]] = {method: [] for method in METHODS}
        for seed in range(given.draws if count is not None else 1):
            names = draw(clips, count, seed)
            sizes.append(len(names))
            for method, annotator in annotators(store, names, given.classes, executor).items():
                found[method].append(counts(annotator, words, truth))
        print(line("all" if count is None else str(count), sizes, found), flush=True)
    executor.close()


if __name__ == "__main__":
    main()
