"""`python -m studies.new_studio BANDAI CMU TRUTH`: takes of a new studio, with labels of some of them as examples.

BANDAI is the store of `python -m studies.bandai`: dataset 1 is the old studio, all of whose contents have templates,
and dataset 2 the new one. Takes of the contents that both share are labelled; of so many takes of each content the
labels are examples beside the clips of dataset 1, of the same templates or of templates of their own, and the others
are judged.

CMU is the store of `kinedex run hdm05-cmu`, TRUTH the ground truth of its takes: templates of HDM05 annotate CMU's
take 01_01. The labels of its first jumps are examples of a further template of a jump, and what comes after the third
jump is judged; then so many jumps are drawn, and what is not within them is judged.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from kinedex.catalog.classes import OWN, Classes, load_classes
from kinedex.ops.arrays import U64
from kinedex.ops.evaluation.detection import bootstrap
from kinedex.ops.evaluation.metrics import Counts, compare, pooled
from kinedex.ops.intervals import analysis_frame
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation.annotators import make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import annotation_method
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips, learn_templates
from kinedex.storage.formats.labels.formats import read_labels
from kinedex.storage.store.store import Store, open_store
from studies.decoding import Clip, clips_of

METHODS = ("thesis", "best")
DELTA, TAU = 0.05, 0.13
COUNTS = (0, 1, 2, 3, 5, 10)
LEAST = 8  # of a content of dataset 1; others have no template
JUMP, FIRST_JUMPS = "jump", 3
OLD_SIDE = "actor IN ('bd', 'bk', 'dg')"


@dataclass(frozen=True)
class Judged:
    """Words to annotate, and their true segments (class, start, stop)."""

    words: U64
    truth: tuple[tuple[str, int, int], ...]


class Templates:
    """Templates of clips by subclass, each learned once."""

    def __init__(self, store: Store, executor: Executor) -> None:
        self.store, self.executor = store, executor
        self._known: dict[tuple[str, tuple[bytes, ...]], SubclassTemplate] = {}

    def of(self, clips: Sequence[Clip]) -> list[SubclassTemplate]:
        """Return the soft template of each subclass."""
        groups: dict[str, list[Clip]] = defaultdict(list)
        for clip in clips:
            groups[clip.label].append(clip)
        found = []
        for label, own in sorted(groups.items()):
            key = label, tuple(clip.words.tobytes() for clip in own)
            if key not in self._known:
                names = tuple(f"{place:04}" for place in range(len(own)))
                one = TrainingClips(label, names, tuple(clip.words for clip in own))
                ((self._known[key],),) = learn_templates([one], ["soft"], self._features, self.executor)
            found.append(self._known[key])
        return found

    @property
    def _features(self) -> int:
        return len(self.store.feature_set.features)

    def counts(self, clips: Sequence[Clip], classes: Classes, takes: Sequence[Judged], method: str) -> list[Counts]:
        """Annotate takes with templates of clips, and count the agreement with the truth of each."""
        words = [clip.words for clip in clips]
        annotator = make_annotator(
            self.store.feature_set, self.of(clips), classes, DELTA, TAU, method=annotation_method(method),
            clips=lambda: words,
        )  # fmt: skip
        offsets = np.cumsum([0, *(len(one.words) for one in takes)]).astype(np.int64)
        laid = TakeWords(np.arange(len(takes)), offsets, np.concatenate([one.words for one in takes]))
        found = []
        for take, own in zip(takes, annotate_words(annotator, laid), strict=True):
            automatic = [(annotator.classes[one.class_index], one.start, one.stop) for one in own.segments]
            sides = [
                [[(start, stop) for name, start, stop in side if name == label] for side in (automatic, take.truth)]
                for label in annotator.classes
            ]
            found.append(pooled(compare(*both) for both in sides))
        return found


def line(found: Sequence[Sequence[Counts]]) -> str:
    """Return two cells: F (frames) and F (segments), over draws, with 95 % intervals over the takes of all draws."""
    every = [one for counts in found for one in counts]
    cells = []
    measures: list[Callable[[Counts], float]] = [lambda one: one.f1, lambda one: one.f2]
    for measure in measures:
        mean = np.mean([measure(pooled(counts)) for counts in found])
        ends = bootstrap(measure, every) if len(every) > len(found) else None
        spread = f" ({ends[0]:.2f}–{ends[1]:.2f})" if ends else ""
        if ends is None and len(found) > 1:
            spread = f" ± {np.std([measure(pooled(counts)) for counts in found], ddof=1):.2f}"
        cells.append(f"{mean:.2f}{spread}")
    return " | ".join(cells)


def bandai(store: Store, draws: int, executor: Executor, *, apart: bool) -> None:
    """Print the table of Bandai; new examples join those of their content, or have templates of their own."""
    takes = store.takes("class IS NOT NULL AND actor IS NOT NULL").sort("name")
    clips = dict(zip(takes["name"].to_list(), clips_of(store, "true"), strict=True))
    counts = takes.with_columns(old=pl.col("name").str.starts_with("dataset-1")).group_by("class", "old").len()
    usual = set(counts.filter(pl.col("old") & (pl.col("len") >= LEAST))["class"])
    shared = sorted(usual & set(counts.filter(~pl.col("old"))["class"]))
    old = [clip for name, clip in clips.items() if name.startswith("dataset-1") and clip.label in usual]
    new = [clip for name, clip in clips.items() if not name.startswith("dataset-1") and clip.label in shared]
    shown = load_classes(OWN, usual)
    classes = Classes(tuple(replace(one, subclasses=(one.name, f"new {one.name}")) for one in shown.classes))
    templates = Templates(store, executor)
    print(f"{len(old)} clips of {len(usual)} contents of dataset 1; {draws} draws; ", end="")
    print(f"{len(new)} takes of dataset 2: {', '.join(shared)}; ", end="")
    print("templates of their own\n" if apart else "new examples join the old ones\n")
    header()
    for count in COUNTS:
        found: dict[str, list[list[Counts]]] = {method: [] for method in METHODS}
        for seed in range(draws if count else 1):
            random = np.random.default_rng(seed)
            groups = {label: [clip for clip in new if clip.label == label] for label in shared}
            orders = {label: random.permutation(len(own)).tolist() for label, own in groups.items()}
            drawn = [groups[label][place] for label in shared for place in orders[label][:count]]
            if apart:
                drawn = [replace(clip, label=f"new {clip.label}") for clip in drawn]
            # the same takes are judged, however many are labelled
            rest = [groups[label][place] for label in shared for place in orders[label][max(COUNTS) :]]
            judged = [Judged(clip.words, ((clip.label, 0, len(clip.words)),)) for clip in rest]
            for method in METHODS:
                found[method].append(templates.counts([*old, *drawn], classes, judged, method))
        print(f"| {count} | {' | '.join(line(found[method]) for method in METHODS)} |", flush=True)


def header() -> None:
    """Print the head of a table."""
    print("| labelled | thesis: F (frames) | F (segments) | best: F (frames) | F (segments) |\n|--:|---|---|---|---|")


def cut(take: Judged, ranges: Sequence[tuple[int, int]]) -> Iterator[Judged]:
    """Yield what is left of a take without some ranges, with the true segments in it."""
    edges = [0, *(edge for one in sorted(ranges) for edge in one), len(take.words)]
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if start < stop:
            inside = [(name, max(a, start), min(b, stop)) for name, a, b in take.truth if a < stop and start < b]
            yield Judged(take.words[start:stop], tuple((name, a - start, b - start) for name, a, b in inside))


def cmu(store: Store, name: str, truth: Path, draws: int, executor: Executor) -> None:
    """Print the tables of CMU's take 01_01."""
    row = store.takes().row(by_predicate=pl.col("name") == name, named=True)
    rates = row["source_rate_hz"], row["rate_hz"]
    segments = sorted(
        (one.label, *(analysis_frame(edge, *rates) for edge in one.source_frames(rates[0])))
        for one in read_labels(truth).segments
        if one.take == name.rpartition("/")[2]
    )
    take = Judged(store.words([row["take_id"]]).take(0), tuple(segments))
    jumps = sorted((start, stop) for label, start, stop in segments if label == JUMP)
    old = clips_of(store, OLD_SIDE)
    labels = {clip.label for clip in old}
    shipped = load_classes("thesis-15", labels)
    classes = Classes(
        tuple(
            replace(one, subclasses=(*one.subclasses, "new jump")) if one.name == JUMP else one
            for one in shipped.classes
        )
    )
    templates = Templates(store, executor)

    def counts(ranges: Sequence[tuple[int, int]], judged: Sequence[Judged], method: str) -> list[Counts]:
        examples = [Clip("new", "new jump", take.words[start:stop]) for start, stop in ranges]
        return [pooled(templates.counts([*old, *examples], classes, judged, method))]

    print(f"\nCMU {name} after its first {FIRST_JUMPS} jumps: {len(jumps) - FIRST_JUMPS} jumps\n")
    header()
    after = list(cut(take, [(0, jumps[FIRST_JUMPS - 1][1])]))
    for count in range(FIRST_JUMPS + 1):
        cells = [line([counts(jumps[:count], after, method)]) for method in METHODS]
        print(f"| {count} | {' | '.join(cells)} |", flush=True)
    print(f"\nCMU {name} without the jumps that are labelled, {draws} draws of them\n")
    header()
    for count in range(FIRST_JUMPS + 1):
        found: dict[str, list[list[Counts]]] = {method: [] for method in METHODS}
        for seed in range(draws if count else 1):
            chosen = [jumps[place] for place in np.random.default_rng(seed).permutation(len(jumps))[:count].tolist()]
            rest = list(cut(take, chosen))
            for method in METHODS:
                found[method].append(counts(chosen, rest, method))
        print(f"| {count} | {' | '.join(line(found[method]) for method in METHODS)} |", flush=True)


def main() -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m studies.new_studio", description=__doc__)
    parser.add_argument("bandai", type=Path, help="store of `python -m studies.bandai`")
    parser.add_argument("cmu", type=Path, help="store of `kinedex run hdm05-cmu`")
    parser.add_argument("truth", type=Path, help="ground truth of CMU's takes")
    parser.add_argument("--take", default="01_01", help="name of the take with jumps")
    parser.add_argument("--draws", type=int, default=5, help="draws of the labelled takes")
    given = parser.parse_args()
    executor = make_executor("serial", None)
    for apart in (False, True):
        bandai(open_store(given.bandai), given.draws, executor, apart=apart)
    cmu(open_store(given.cmu), given.take, given.truth, 2 * given.draws, executor)


if __name__ == "__main__":
    main()
