"""`python -m studies.bandai SOURCE`: label Bandai's takes by content, from five example clips of each content.

All BVH files below SOURCE are ingested into one store; their names contain content and style. Of every content with at
least `--least` takes, five are drawn as examples, whatever their style; every other take counts as unlabelled and gets
the content that labels most of its frames, or none. This is repeated with other draws. Nothing is chosen by the
results: the parameters are those of the pipeline `annotate`. (Those of method best were chosen, among others, on takes
of dataset 1 with styles left out, see `studies.decoding`; dataset 2 had no part in it.)
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

from benchmarks.harness import silent
from kinedex.catalog.classes import load_classes
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_stored
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.templates.template_learning import learn_templates, training_clips
from kinedex.storage.store.store import Store, open_store
from studies import BUILD

PATTERN = r"dataset-\d_(?P<class>[^_]+)_(?P<actor>[^_]+)_(?P<clip>\d+)\."  # the column `actor` holds the style
Bool = npt.NDArray[np.bool_]
F64 = npt.NDArray[np.float64]

METHODS = ("thesis", "best")
DELTA, TAU = 0.05, 0.13
NONE = "(none)"

SCHEMA = {
    "method": pl.String, "seed": pl.Int64, "take": pl.String, "set": pl.String, "content": pl.String,
    "style": pl.String, "label": pl.String, "frames": pl.Int64, "right": pl.Int64, "wrong": pl.Int64,
}  # fmt: skip


@dataclass(frozen=True)
class Draw:
    """The names of the example takes, and the takes that count as unlabelled."""

    examples: tuple[str, ...]
    rest: pl.DataFrame


def ingest(source: Path, path: Path) -> Store:
    """Ingest the files into a store whose takes have content as class and style as actor."""
    assignments = {"source": str(source), "patterns": f"['{PATTERN}']"}
    run_pipeline("ingest", path, assignments=assignments, terminal=silent())
    return open_store(path)


def draw(takes: pl.DataFrame, seed: int, examples: int, least: int) -> Draw:
    """Draw the examples of each content that has enough takes; takes of other contents are excluded.

    Parameters
    ----------
    takes : polars.DataFrame
        Takes with the columns name and class.
    seed : int
        The seed of the draw.
    examples : int
        The number of examples of a class.
    least : int
        The number of takes that a class must have to take part.
    """
    generator = np.random.default_rng(seed)
    chosen: list[str] = []
    rest = []
    for _, group in takes.drop_nulls("class").sort("class", "name").group_by("class", maintain_order=True):
        order = generator.permutation(group.height)
        if group.height >= max(least, examples + 1):
            chosen += group["name"].gather(order[:examples]).to_list()
            rest.append(group[np.sort(order[examples:])])
    return Draw(tuple(chosen), pl.concat(rest) if rest else takes.clear())


def annotators(store: Store, examples: Sequence[str], executor: Executor) -> dict[str, Annotator]:
    """Return an annotator of each method with the templates of the example takes."""
    takes = store.takes().filter(pl.col("name").is_in(examples))
    clips = training_clips(store, takes)
    features = len(store.feature_set.features)
    templates = [one for task in learn_templates(clips, ["soft"], features, executor) for one in task]
    classes = load_classes("own", {one.subclass for one in templates})
    words = [store.words(takes["take_id"].to_list()).words]
    return {
        method: make_annotator(
            store.feature_set, templates, classes, DELTA, TAU, method=annotation_method(method), clips=lambda: words
        )
        for method in METHODS
    }


def labelled(store: Store, drawn: Draw, seed: int, executor: Executor) -> Iterator[dict[str, object]]:
    """Yield a row for each unlabelled take and method: its label, and its frames labelled right and wrong."""
    rows = {row["take_id"]: row for row in drawn.rest.iter_rows(named=True)}
    for method, annotator in annotators(store, drawn.examples, executor).items():
        for batch in annotate_stored(store, annotator, drawn.rest, executor, False):
            for one in batch:
                row = rows[one.take_id]
                covered = np.zeros((len(annotator.classes), row["frames"]), bool)
                costs = np.full(len(annotator.classes), np.inf)
                for segment in one.segments:
                    covered[segment.class_index, segment.start : segment.stop] = True
                    costs[segment.class_index] = np.fmin(costs[segment.class_index], segment.cost)
                yield _row(method, seed, row, annotator.classes, covered, costs)


def winner(covered: Bool, costs: F64) -> int | None:
    """Return the class that labels most frames, of several the one of the lowest cost; None without labels.

    Segments of the thesis's method overlap, and often several classes label all of a take.
    """
    counts = covered.sum(axis=1)
    if not counts.any():
        return None
    return int(np.lexsort((costs, -counts))[0])


def _row(
    method: str, seed: int, take: dict[str, object], classes: Sequence[str], covered: Bool, costs: F64
) -> dict[str, object]:
    most = winner(covered, costs)
    right = covered[classes.index(str(take["class"]))]
    wrong = covered.any(axis=0) & ~right
    return {
        "method": method, "seed": seed, "take": take["name"], "set": take["set"], "content": take["class"],
        "style": take["actor"], "label": NONE if most is None else classes[most], "frames": take["frames"],
        "right": int(right.sum()), "wrong": int(wrong.sum()),
    }  # fmt: skip


def summary(rows: pl.DataFrame, *by: str) -> pl.DataFrame:
    """Return per cent of takes and of frames labelled right: mean and standard deviation over the draws.

    Returns
    -------
    polars.DataFrame
        The columns of `by`, takes (a draw, on average), accuracy, sd, frames (labelled right), wrong, none (not
        labelled).
    """
    one = rows.group_by(*by, "seed").agg(
        takes=pl.len(),
        accuracy=100 * (pl.col("label") == pl.col("content")).mean(),
        frames=100 * pl.col("right").sum() / pl.col("frames").sum(),
        wrong=100 * pl.col("wrong").sum() / pl.col("frames").sum(),
    )
    return (
        one.group_by(*by)
        .agg(
            pl.col("takes").mean(),
            pl.col("accuracy").mean(),
            pl.col("accuracy").std().fill_null(0.0).alias("sd"),
            pl.col("frames").mean(),
            pl.col("wrong").mean(),
        )
        .with_columns(none=100 - pl.col("frames") - pl.col("wrong"))
        .sort(*by)
    )


def confusions(rows: pl.DataFrame, method: str, most: int) -> pl.DataFrame:
    """Return the labels that takes of a content get instead, the most frequent first; takes are means over draws."""
    seeds = rows["seed"].n_unique()
    own = rows.filter(pl.col("method") == method)
    totals = own.group_by("content").agg(of=pl.len() / seeds)
    wrong = own.filter(pl.col("label") != pl.col("content"))
    found = wrong.group_by("content", "label").agg(takes=pl.len() / seeds).join(totals, on="content")
    return found.sort("takes", "content", "label", descending=[True, False, False]).head(most)


def side_by_side(rows: pl.DataFrame, by: str) -> list[str]:
    """Return a Markdown table of the accuracy of both methods by a column."""
    lines = [
        f"| {by} | takes | thesis: takes right | frames right | wrong | best: takes right | frames right | wrong |",
        "|---|---|---|---|---|---|---|---|",
    ]
    table = summary(rows, "method", by)
    for name in table[by].unique().sort():
        own = {row["method"]: row for row in table.filter(pl.col(by) == name).iter_rows(named=True)}
        cells = [
            f"{own[m]['accuracy']:.0f} ± {own[m]['sd']:.0f} % | {own[m]['frames']:.0f} % | {own[m]['wrong']:.0f} %"
            for m in METHODS
        ]
        lines.append(f"| {name} | {own['thesis']['takes']:.0f} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Ingest, label, and print the tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.bandai", description=__doc__)
    parser.add_argument("source", type=Path, help="folder of the BVH files")
    parser.add_argument("--store", type=Path, default=BUILD / "bandai-store")
    parser.add_argument("--seeds", type=int, default=10, help="draws of the examples")
    parser.add_argument("--examples", type=int, default=5, help="of each content")
    parser.add_argument("--least", type=int, default=8, help="contents with fewer takes are excluded")
    given = parser.parse_args()
    store = ingest(given.source, given.store)
    takes = store.takes().with_columns(set=pl.col("name").str.extract(r"^(dataset-\d)"))
    counts = takes.group_by("class").len().sort("class")
    few = counts.filter(pl.col("len") < given.least)
    print(f"{takes.height} takes of {counts.height} contents; with fewer than {given.least} takes, left out: ", end="")
    print(", ".join(f"{name} ({count})" for name, count in few.iter_rows()) or "none")
    executor = make_executor("serial", None)
    found: list[dict[str, object]] = []
    for seed in range(given.seeds):
        found += labelled(store, draw(takes, seed, given.examples, given.least), seed, executor)
    executor.close()
    report(pl.DataFrame(found, schema=SCHEMA).with_columns(archive=pl.lit("all")), given.seeds)


def report(rows: pl.DataFrame, seeds: int) -> None:
    """Print all tables: altogether, by data set, content and style, and the confusions."""
    print(f"{seeds} draws; mean ± standard deviation over them\n")
    for by in ("archive", "set", "content", "style"):
        print("\n".join(side_by_side(rows, by)) + "\n")
    for method in METHODS:
        print(f"| {method}: content | labelled as | takes a draw | of |\n|---|---|---|---|")
        for row in confusions(rows, method, 14).iter_rows(named=True):
            print(f"| {row['content']} | {row['label']} | {row['takes']:.1f} | {row['of']:.0f} |")
        print()


if __name__ == "__main__":
    main()
