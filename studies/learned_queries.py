"""`python -m studies.learned_queries STORE`: test learned keyframe queries on people who were left out.

Queries are learned without the clips of one actor and searched in these, joined to takes in random order; for every
actor in turn, and for every variant of the learning. Takes with ground truth, if the store has some, are searched with
queries learned from all clips; nothing is chosen by them. Tables are Markdown, as in docs/keyframe-study.md.

Intervals cover 95 %. Those of shares draw people within each class, and segments (or takes) of each person; of a single
person, takes. Those of counts are Wilson's.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kinedex.catalog.classes import load_classes
from kinedex.ops.evaluation.metrics import Counts, pooled
from kinedex.ops.evaluation.reliability import wilson
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.executors import Executor, make_executor
from kinedex.pipelines.keyframes.learning_runs import learn_queries
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.query_learning import Outcome, TrainingSet, training_sets
from kinedex.pipelines.templates.template_learning import TrainingClips, training_clips
from kinedex.storage.store.store import Store, open_store
from studies.keyframe_places import Measured, Searched, annotated, joined, measured, with_ground_truth
from studies.two_stage_interval import two_stage_interval

THESIS = "numbers of the thesis"
NO_QUERIES = "no queries"

VARIANTS: dict[str, dict[str, object]] = {
    "genetic": {},
    "random search": {"learner": "random"},
    "greedy columns": {"learner": "greedy"},
    THESIS: {},
    NO_QUERIES: {},
    "random search, numbers of the thesis": {"learner": "random"},
    "greedy columns, numbers of the thesis": {"learner": "greedy"},
    "one query a class": {"alternatives": 1},
    "three queries a class": {"alternatives": 3},
    "margins of each query": {"margins": "learned"},
    "the consensus first": {"at_least": "median"},
    "as before": {"at_least": "median", "margins": "learned", "outside_cost": 0.0},
    "outside_cost 0": {"outside_cost": 0.0},
    "steady 0": {"steady": 0},
    "tempo 0": {"tempo": 0.0},
    "joins 0": {"joins": 0},
    "parsimony 0": {"parsimony": 0.0},
    "gap_cost 0": {"gap_cost": 0.0},
    "100 generations": {"generations": 100},
}
"""The changes of each variant to the numbers of `configs/pipelines/keyframes.yaml` or of the thesis."""


@dataclass
class Found:
    """The results at one place: those of each class, and the counts of its labels where takes are annotated."""

    classes: list[Measured] = field(default_factory=list)
    labels: dict[str, Counts] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """The settings that all variants share."""

    store: Store
    executor: Executor
    runs: int
    seeds: int
    clips_only: bool
    annotate: bool


def main() -> None:
    """Measure the variants and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("store", type=Path)
    parser.add_argument("--variant", action="append", choices=sorted(VARIANTS), help="only this one; may be repeated")
    parser.add_argument("--runs", type=int, default=16)
    parser.add_argument("--seeds", type=int, default=1, help="how often the whole is repeated, with other seeds")
    parser.add_argument("--workers", type=int, default=None)
    parser.add_argument("--clips-only", action="store_true", help="leave the takes with ground truth out")
    parser.add_argument("--annotate", action="store_true", help="label the takes too (thesis's method, τ = 0.13)")
    parser.add_argument("--by-class", action="store_true", help="a table of classes for each variant")
    arguments = parser.parse_args()
    executor = make_executor("processes", arguments.workers)
    store, sizes = open_store(arguments.store), (arguments.runs, arguments.seeds)
    study = Study(store, executor, *sizes, arguments.clips_only, arguments.annotate)
    names = arguments.variant or [name for name in VARIANTS if name != NO_QUERIES or study.annotate]
    heads = ["variant", "left out", "segments hit", "in all", "of them covered", "frames kept"]
    heads += ["F (frames)", "F (segments)"] if study.annotate else []
    print(f"| {' | '.join(heads)} |\n{'|---' * len(heads)}|")
    details = {}
    for name in names:
        positions = measure(study, name)
        details[name] = positions
        people = [found for place, found in positions.items() if place != "takes"]
        print(_line(name, "each actor in turn", people, study), flush=True)
        for place, found in positions.items():
            print(_line("", place, [found], study), flush=True)
    if arguments.by_class:
        for name, positions in details.items():
            if name != NO_QUERIES:
                _by_class(name, positions)
    executor.close()


def measure(study: Study, variant: str) -> dict[str, Found]:
    """Learn without each actor and search that actor; then learn from all and search the takes with ground truth."""
    takes = study.store.takes("class IS NOT NULL")
    clips = training_clips(study.store, takes)
    actor_of = dict(takes.select("name", "actor").iter_rows())
    found: dict[str, Found] = {}
    for seed in range(study.seeds):
        params = None if variant == NO_QUERIES else params_of(variant, study.runs, seed)
        for actor in sorted(set(actor_of.values())):
            own = {name for name, other in actor_of.items() if other == actor}
            rest = [part for one in clips if (part := one.without(own)).names]
            others = set(actor_of) - own
            held = [part for one in clips if (part := one.without(others)).names]
            _search(study, rest, joined(held, seed), params, found.setdefault(actor, Found()))
        manual = None if study.clips_only else with_ground_truth(study.store)
        if manual is not None:
            _search(study, clips, manual, params, found.setdefault("takes", Found()))
    return found


def params_of(variant: str, runs: int, seed: int) -> KeyframeParameters:
    """Return the parameters of a variant."""
    own: dict[str, object] = {"runs": runs, "seed": 2012 + seed, **VARIANTS[variant]}
    if variant.endswith(THESIS):
        return KeyframeParameters(**own)  # type: ignore[arg-type]
    shipped = load_pipeline("keyframes").stage("learn_keyframes").params
    assert isinstance(shipped, KeyframeParameters)
    return KeyframeParameters(**{**shipped.model_dump(), **own})


def _search(
    study: Study, clips: Sequence[TrainingClips], searched: Searched, params: KeyframeParameters | None, found: Found
) -> None:
    """Learn from clips, search takes, and add the results; without parameters there are no queries."""
    outcomes = [] if params is None else _learned(study, clips, params)
    features = len(study.store.feature_set.features)
    every = [measured(outcome, searched, features) for outcome in outcomes]
    found.classes += [one for one in every if one is not None]
    if study.annotate:
        for label, counts in annotated(study.store, clips, outcomes, searched, study.executor).items():
            found.labels[label] = found.labels.get(label, Counts()) + counts


def _learned(study: Study, clips: Sequence[TrainingClips], params: KeyframeParameters) -> list[Outcome]:
    setting = setting_of(params, study.store)
    rounds = params.rounds()
    wanted: list[TrainingSet] = training_sets(clips, load_classes("own", [one.subclass for one in clips]))
    return [one.outcome for one in learn_queries(wanted, setting, rounds, study.executor)]


# ---- tables ----------------------------------------------------------------------------------------------


def _line(name: str, place: str, positions: Sequence[Found], study: Study) -> str:
    rows = [one for found in positions for one in found.classes]
    cells = [name, place, *(_shares(rows, len(positions)) if rows else ["–", "–", "–", "100.0%"])]
    if study.annotate:
        labels = pooled(counts for found in positions for counts in found.labels.values())
        cells += [f"{labels.f1:.3f}", f"{labels.f2:.3f}"]
    return f"| {' | '.join(cells)} |"


def _shares(rows: Sequence[Measured], people: int) -> list[str]:
    classes = [[one for one in rows if one.label == label] for label in sorted({one.label for one in rows})]
    hit = two_stage_interval([[one.hit for one in own] for own in classes])
    kept = two_stage_interval([[one.kept for one in own] for own in classes])
    return [
        # a single person leaves nobody else to draw
        f"{np.mean([one.hit_share for one in rows]):.3f}" + (f" ({hit[0]:.2f}–{hit[1]:.2f})" if people > 1 else ""),
        _count(rows),
        f"{np.mean([one.covered for one in rows]):.2f}",
        f"{np.mean([one.kept_share for one in rows]):.1%} ({kept[0]:.1%}–{kept[1]:.1%})",
    ]


def _count(rows: Sequence[Measured]) -> str:
    hit, total = sum(int(one.hit[:, 0].sum()) for one in rows), sum(len(one.hit) for one in rows)
    low, high = wilson(hit, total)
    return f"{hit}/{total} ({low:.2f}–{high:.2f})"


def _by_class(name: str, positions: dict[str, Found]) -> None:
    print(f"\n{name}: segments hit of all; in per cent the frames kept (the class's own)\n")
    people = [place for place in positions if place != "takes"]
    heads = [*people, "all of them", *(place for place in positions if place == "takes")]
    labelled = [head for head in heads[len(people) :] if any(found.labels for found in positions.values())]
    print(f"| class | {' | '.join([*heads, *(f'labels right, {head}' for head in labelled)])} |")
    print("|---" * (1 + len(heads) + len(labelled)) + "|")
    for label in sorted({one.label for found in positions.values() for one in found.classes}):
        cells = []
        for head in heads:
            inside = [positions[place] for place in (people if head == "all of them" else [head])]
            own = [one for found in inside for one in found.classes if one.label == label]
            kept, share = (np.mean([getattr(one, key) for one in own] or [0.0]) for key in ("kept_share", "own"))
            count = _count(own) if head == "all of them" else _count(own).split(" ")[0]
            cells.append(f"{count}, {kept:.0%} ({share:.0%})" if own else "–")
        for head in labelled:
            inside = [positions[place] for place in (people if head == "all of them" else [head])]
            counts = pooled(found.labels.get(label, Counts()) for found in inside)
            cells.append(f"{counts.segments_automatic_hit}/{counts.segments_automatic}")
        print(f"| {label} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
