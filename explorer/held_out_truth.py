"""Ground truth of takes that a template was not learned from: of an evaluation, or labels of people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinedex.explorer.template_use import TemplateUse
from kinedex.ops.wording import counted, few
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.learning import SubclassTemplate
from kinedex.storage.snapshot.labels import is_of_limbs
from kinedex.storage.store.store import Store

Source = Literal["evaluation", "labels"]

SOURCES: tuple[Source, ...] = ("evaluation", "labels")

MOST_SECONDS = 3600.0
"""Maximum number of seconds of held-out takes, in all, for an evaluation, unless all takes are asked for."""

Segments = dict[str, list[tuple[int, int]]]
"""A dict from take name to the segments [start, stop) of one class in it, in frames; an empty list if it has none."""


@dataclass(frozen=True)
class HeldOut:
    """The takes that a template is judged by.

    Attributes
    ----------
    source : {"evaluation", "labels"}, optional
        The ground truth; None where the store has none.
    sources : tuple of str
        The kinds of ground truth that the store has.
    takes : dict of int to list of (int, int)
        The segments of the class in each take that is held out.
    every : tuple of int
        The ids of all takes that are held out; `takes` are some of them where all would take long.
    among_examples : int
        Takes with ground truth that the class has examples of, and that are not judged by.
    missing : str
        The reason why there is no held-out take, and what to do; empty if there are some.
    remarks : tuple of str
        Remarks on what was excluded, and on limits of the numbers.
    """

    source: Source | None
    sources: tuple[Source, ...]
    takes: dict[int, list[tuple[int, int]]]
    every: tuple[int, ...]
    among_examples: int
    missing: str = ""
    remarks: tuple[str, ...] = ()


def held_out_takes(
    store: Store,
    use: TemplateUse,
    label: str,
    templates: Sequence[SubclassTemplate],
    asked: Source | None = None,
    *,
    everything: bool = False,
) -> HeldOut:
    """Return the takes with ground truth that contain no example of the class's templates.

    Parameters
    ----------
    store : Store
        The store.
    use : TemplateUse
        The stage that learned the templates, with the classes of its pipeline.
    label : str
        The class.
    templates : sequence of SubclassTemplate
        The templates of the class.
    asked : {"evaluation", "labels"}, optional
        The source of the ground truth; by default the evaluation if there is one, else labels.
    everything : bool, optional
        True for all takes; otherwise random ones with at most `MOST_SECONDS` in all.
    """
    found: dict[Source, tuple[Segments, list[str]]] = {}
    if use.evaluate is not None:
        found["evaluation"] = evaluated_segments(store, use.evaluate, label), []
    labelled = labelled_segments(store, use, label)
    if labelled[0]:
        found["labels"] = labelled
    sources = tuple(source for source in SOURCES if source in found)
    source = asked if asked in found else next(iter(sources), None)
    if source is None:
        return HeldOut(None, (), {}, (), 0, _no_truth(use))
    known, remarks = found[source]
    examples = {interval_of(clip, store.take_ids)[0] for one in templates for clip in one.clips}
    unknown = [one.subclass for one in templates if not one.clips]
    if unknown:
        remarks = [
            *remarks,
            f"which takes these templates were made from is not known, as they are of files: {few(unknown)}",
        ]
    gone = sorted(set(known) - set(store.take_ids))
    if gone:
        remarks = [*remarks, f"takes with ground truth that the store has no more: {few(gone)}"]
    judged = {
        store.take_ids[take]: own for take, own in known.items() if take in store.take_ids and take not in examples
    }
    every = sorted(judged)
    takes = {take: judged[take] for take in (every if everything else drawn_takes(store, every))}
    among = sum(take in examples for take in known)
    missing = "" if takes else _all_examples(label, among)
    if takes and not any(takes.values()):
        remarks = [*remarks, f"none of these takes has a segment of {label}: recall is not defined, and F is no guide"]
    return HeldOut(source, sources, takes, tuple(every), among, missing, tuple(remarks))


def drawn_takes(store: Store, takes: Sequence[int]) -> list[int]:
    """Return takes of `MOST_SECONDS` in all, one at least, in a drawn order that is the same each time."""
    order = np.random.default_rng(0).permutation(len(takes)).tolist()
    lengths = np.cumsum([store.take_frames[takes[place]] / store.rate_hz for place in order])
    count = max(1, int(np.searchsorted(lengths, MOST_SECONDS, side="right")))
    return [takes[place] for place in order[:count]]


def _no_truth(use: TemplateUse) -> str:
    return (
        "No take has ground truth. Label some takes in which the class occurs (page Label), or run a pipeline with "
        f"label files or classes to evaluate by: stage {use.stage} has no evaluation of its templates."
    )


def _all_examples(label: str, among: int) -> str:
    return (
        f"All {counted(among, 'take')} with ground truth are among the examples of {label}. Label further takes (page "
        "Label), or learn from a part of the takes, such as those of some actors: the setting `train` of a pipeline."
    )


def evaluated_segments(store: Store, stage: str, label: str) -> Segments:
    """Return the ground truth of a class by which a stage has evaluated, in every take that it has evaluated."""
    run = store.manifest.stages[stage].run
    metrics = store.result("metrics", run=run)
    judged = zip(metrics.column("scope").to_pylist(), metrics.column("name").to_pylist(), strict=True)
    found: Segments = {name: [] for scope, name in judged if scope == "take"}
    rows = store.result("ground_truth", run=run).select(["take", "class", "start", "stop"]).to_pylist()
    for row in rows:
        if row["class"] == label and row["take"] in found:
            found[row["take"]].append((row["start"], row["stop"]))
    return found


def labelled_segments(store: Store, use: TemplateUse, label: str) -> tuple[Segments, list[str]]:
    """Return the positive labels of a class in every take that has a label, and remarks on them."""
    found: Segments = {}
    beyond = []
    columns = ["take", "class", "start", "stop", "verdict", "limb"]
    for row in store.labels().select(columns).to_pylist():
        if is_of_limbs(row):
            continue
        own = found.setdefault(row["take"], [])
        if row["verdict"] != "positive" or (use.classes.class_of(row["class"]) or row["class"]) != label:
            continue
        frames = store.take_frames.get(store.take_ids.get(row["take"], -1))
        if frames is not None and row["stop"] > frames:
            beyond.append(f"{row['take']}[{row['start']}:{row['stop']}]")
            continue
        own.append((row["start"], row["stop"]))
    remarks = ["labels are taken as complete: what nobody has labelled in a take with labels counts as another motion"]
    if beyond:
        remarks.append(f"labels beyond the end of their take, excluded: {few(beyond)}")
    return found, remarks
