"""Search by example: find intervals that are similar to some examples, and dissimilar to others.

`POST /api/ask/examples` {positives: [interval], negatives?: [interval], mirror?, tau?, delta?, top? ≤ 500, where?,
 filters?, name?} with intervals {take_id | take, start, stop, mirrored?}
→ {hits: [hit], total, more, takes, hours, seconds, tau, template: {columns, clips: [name], weights: {feature: number}},
   remarks: [sentence], version, command, python}; `more` is true where there may be further hits below tau.

`POST /api/ask/hit` {the same, hit: interval} → how the template fits one hit: {curve: [cost or null] of the frames from
 `first` on, tau, cost, columns: [column of the template in each frame of the hit], contradicted: [{feature, share}]}

`POST /api/ask/template` {the same} → {name, text}: the template as a file of YAML.

`POST /api/ask/labels` {class, positives, negatives, annotator?, note?} → {recorded, known, remarks, command, python}:
 decisions of a person as labels, and the commands that make them.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field
from starlette.requests import Request

from kinedex.catalog.template_files import write_yaml
from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import post
from kinedex.explorer.hits import ChosenHit, Limit, shown_hits, take_condition
from kinedex.explorer.labels import label_commands
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import Selection
from kinedex.ops.distances.curve_path import curve_paths
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import Hit, in_seconds
from kinedex.ops.ranking.best_hits import rank_together
from kinedex.ops.templates.derived_templates import WILDCARD, restricted_template
from kinedex.ops.templates.templates import QuantisedTemplate, quantise
from kinedex.ops.words import ALL_KNOWN, TakeWords, bits
from kinedex.pipelines.keyframes.slice_search import stored_words
from kinedex.pipelines.labels.decisions import record_decisions
from kinedex.pipelines.templates.chosen_intervals import ChosenTemplate, label_of, template_of_chosen
from kinedex.pipelines.templates.example_ranking import rank_by_examples
from kinedex.pipelines.templates.ranked_hits import RankedTemplate
from kinedex.pipelines.templates.ranking import mirrored_template
from kinedex.pipelines.templates.store_ranking import DELTA, TOP, RankingQuestion
from kinedex.pipelines.templates.store_ranking import EXAMPLE_TAU as TAU
from kinedex.storage.snapshot.schemas import hits_of
from kinedex.storage.store.store import Store

NAME = "example"

SHOWN_SECONDS = 3.0
"""Seconds before and after a hit for which its distance curve is shown."""

MAX_EXAMPLES = 500
MAX_SECONDS = 60.0
"""The longest interval, in seconds, that can be an example; the time of a search grows with its length."""

Examples = Annotated[tuple[ChosenHit, ...], Field(max_length=MAX_EXAMPLES)]


class ExamplesRequest(Selection):
    """A search by example: hits are similar to the intervals `positives`, and dissimilar to `negatives`."""

    positives: Annotated[Examples, Field(min_length=1)]
    negatives: Examples = ()
    mirror: bool = True
    tau: Annotated[float, Field(gt=0, le=1)] = TAU
    delta: Annotated[float, Field(ge=0, lt=0.5)] = DELTA
    top: Limit = TOP
    name: Annotated[str, Field(min_length=1, max_length=100)] = NAME


class HitRequest(ExamplesRequest):
    """A search by example, and one of its hits."""

    hit: ChosenHit


class LabelsRequest(Selection):
    """Hits that a person has accepted and rejected for a class."""

    label: Annotated[str, Field(min_length=1, max_length=200, alias="class")]
    positives: Examples = ()
    negatives: Examples = ()
    annotator: str | None = None
    note: str | None = None


def find_similar(archive: Archive, asked: ExamplesRequest, _request: Request) -> dict[str, Any]:
    """Return the intervals of the archive that are most similar to the examples."""
    begin = time.perf_counter()
    store = archive.store()
    made = _template(store, asked)
    mirror = asked.mirror and bool(store.feature_set.mirror)
    condition = take_condition(store, asked)
    positives, negatives = ([one.hit(store) for one in side] for side in (asked.positives, asked.negatives))
    question = RankingQuestion(asked.delta, asked.tau, asked.top, condition, mirror, 1)
    found = rank_by_examples(store, made.named, positives, question, negatives)
    (ranking,) = found.rankings
    weights = () if made.weights is None else zip(_features(store), made.weights.tolist(), strict=True)
    return {
        "hits": shown_hits(store, hits_of(ranking.hits)),
        "total": len(ranking),
        "more": len(ranking) == asked.top,
        "hours": in_seconds(ranking.frames, store.rate_hz) / 3600,
        "seconds": time.perf_counter() - begin,
        "tau": asked.tau,
        "template": {
            "columns": len(made.named.template),
            "clips": list(made.clips),
            "weights": {name: round(weight, 3) for name, weight in weights if weight != 1},
        },
        "remarks": [*made.remarks, *found.remarks, *found.misses(asked.tau, "a τ of ")],
        "version": store.manifest.version,
        **_same(archive, store, asked, condition),
    }


def _template(store: Store, asked: ExamplesRequest) -> ChosenTemplate:
    """Return the template that is learned from the examples of a request."""
    accepted, rejected = ([one.hit(store) for one in side] for side in (asked.positives, asked.negatives))
    longest = in_seconds(max(one.interval.frames for one in accepted), store.rate_hz)
    if longest > MAX_SECONDS:
        raise KinedexError(
            f"an example of {longest:.0f} s: at most {MAX_SECONDS:g} s; choose the interval that shows the motion once"
        )
    return template_of_chosen(store, asked.name, accepted, rejected, asked.delta)


def _features(store: Store) -> list[str]:
    return [feature.name for feature in store.feature_set.features]


def _same(archive: Archive, store: Store, asked: ExamplesRequest, condition: str | None) -> dict[str, str]:
    """Return the command and the Python lines of a search by example."""
    options = [*(["--mirror"] if asked.mirror else []), "--tau", f"{asked.tau:g}", "--top", str(asked.top)]
    options += ["--where", condition] if condition is not None else []
    more = f"tau={asked.tau:g}, top={asked.top}" + (f", where={condition!r}" if condition is not None else "")
    more += ", mirror=True" if asked.mirror else ""
    positives, negatives = ([one.hit(store) for one in side] for side in (asked.positives, asked.negatives))
    unlike = [label_of(one) for one in negatives]
    rejected = f"rejected={unlike!r}, " if unlike else ""
    for one in unlike:
        options += ["--unlike", one]
    if len(positives) == 1 and not positives[0].mirrored:
        take, start, stop = positives[0].interval
        interval = ["--take", take, "--start", str(start), "--stop", str(stop)]
        asking = f"store.similar({take!r}, {start}, {stop}, {rejected}{more})"
    else:
        interval = [word for one in positives for word in ("--like", label_of(one))]
        asking = f"store.similar({[label_of(one) for one in positives]!r}, {rejected}{more})"
    return {
        "command": command_line("kinedex", "rank", archive.path, *interval, *options),
        "python": python_lines(archive.path, asking),
    }


def describe_hit(archive: Archive, asked: HitRequest, _request: Request) -> dict[str, Any]:
    """Return the distance curve around a hit, its warping path, and the features that it contradicts."""
    store = archive.store()
    hit = asked.hit.hit(store)
    template = _fitted(store, asked, hit)
    take, start, stop = hit.interval
    words = stored_words(store, [store.take_ids[take]]).take(0)
    around = round(SHOWN_SECONDS * store.rate_hz)
    first, last = max(0, start - around), min(len(words), stop + around)
    # a path may begin this far before the first frame that is shown
    begin = max(0, first - 2 * len(template))
    curve = distance_curves([template], words[begin:last])[0][first - begin :]
    end = stop - 1
    path = curve_paths(template, words, np.array([end], np.int64))[0] if np.isfinite(curve[end - first]) else None
    features = _features(store)
    contradicted: list[dict[str, Any]] = []
    if path is not None:
        visited = path.columns == np.rint(path.columns)  # fractional columns belong to frames that a (1,2) step skips
        asked_values = template.values(len(features))[path.columns[visited].astype(np.int64)]
        seen = bits(words[path.start : stop][visited], len(features))
        wrong = ((asked_values != WILDCARD) & (asked_values != seen)).mean(axis=0)
        order = np.argsort(-wrong, kind="stable")
        contradicted = [{"feature": features[i], "share": float(wrong[i])} for i in order.tolist() if wrong[i] > 0]
    return {
        "first": first,
        "curve": [None if not np.isfinite(cost) else round(float(cost), 5) for cost in curve],
        "tau": asked.tau,
        "cost": None if path is None else float(curve[end - first]),
        "start": start if path is None else path.start,
        "columns": [] if path is None else np.round(path.columns, 2).tolist(),
        "template_columns": len(template),
        "contradicted": contradicted,
    }


def _fitted(store: Store, asked: HitRequest, hit: Hit) -> QuantisedTemplate:
    """Return the template in the form that matched a hit: mirrored or not, with the features known in its take."""
    made = _template(store, asked)
    whole = RankedTemplate(asked.name, quantise(made.named.template, asked.delta))
    if hit.mirrored:
        whole = mirrored_template(whole, store.feature_set)
    found = restricted_template(whole.template, store.known.get(store.take_ids[hit.interval.take], int(ALL_KNOWN)))
    if found is None:
        raise KinedexError("the template is not applied to this take: its body lacks joints of most of the entries")
    return found


def write_template(archive: Archive, asked: ExamplesRequest, _request: Request) -> dict[str, Any]:
    """Return the template of the examples as the text of a file."""
    store = archive.store()
    made = _template(store, asked)
    named = replace(made.named, name=asked.name)
    return {"name": asked.name, "text": write_yaml([named], store.feature_set), "remarks": list(made.remarks)}


def save_labels(archive: Archive, asked: LabelsRequest, _request: Request) -> dict[str, Any]:
    """Record accepted hits as positive labels of a class and rejected ones as negative, on disk before it returns."""
    store = archive.store()
    rows = [
        {
            **chosen.hit(store).interval._asdict(),
            "class": asked.label,
            "verdict": verdict,
            "origin": "drawn",
            "annotator": asked.annotator,
            "note": asked.note,
        }
        for verdict, side in (("positive", asked.positives), ("negative", asked.negatives))
        for chosen in side
    ]
    standing = {row["id"]: row for row in store.labels().to_pylist()}
    done = record_decisions(store, rows)
    archive.labels_changed()
    return {
        "recorded": done.rows.num_rows,
        "known": done.known,
        "remarks": list(done.remarks),
        **label_commands(archive, done.rows.to_pylist(), standing),
    }


def warm_up() -> None:
    """Load the kernels of a search by ranking a few words in this thread."""
    words = np.arange(400, dtype=np.uint64) % 7
    example = QuantisedTemplate(np.full(70, 7, np.uint64), words[:70])
    few = TakeWords(np.zeros(1, np.int64), np.array([0, len(words)], np.int64), words)
    rank_together([example, example], few, np.array([TAU, TAU]), 2)
    rank_together([example, example], few, np.array([TAU, TAU]), None)


routes = [
    post("/api/ask/examples", find_similar, ExamplesRequest),
    post("/api/ask/hit", describe_hit, HitRequest),
    post("/api/ask/template", write_template, ExamplesRequest),
    post("/api/ask/labels", save_labels, LabelsRequest, writes=True),
]
